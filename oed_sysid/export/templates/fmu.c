/* $origin.
 *
 * Functions of the Functional Mock-up Interface 2.0 for co-simulation around ${name}.c. One instance
 * is one vehicle. Value references: 0 to NU - 1 inputs, then outputs, parameters, and start values
 * of the own states; then the states.
 */
#include "$name.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* Types as the standard declares them. */
typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef char fmi2Char, fmi2Byte;
typedef const fmi2Char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated }
    fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

#define NU ${upper}_INPUTS
#define NY ${upper}_OUTPUTS
#define NP ${upper}_PARAMETERS
#define NO ${upper}_OWN
#define NX ${upper}_STATES
#define MAX1(n) ((n) > 0 ? (n) : 1)
static const char *const guid = "{$guid}";

typedef struct {
    double u[MAX1(NU)], p[MAX1(NP)], own[MAX1(NO)], z[MAX1(${upper}_FULL)];
    double t, since;
    int running;
} vehicle;

static void settle(vehicle *one)
{
    memset(one, 0, sizeof *one);
    memcpy(one->p, ${name}_values, sizeof(double) * NP);
    one->since = 1.0;
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n,
                                      const fmi2String categories[])
{
    (void)c; (void)on; (void)n; (void)categories;
    return fmi2OK;
}

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String stated,
                                     fmi2String place, const fmi2CallbackFunctions *functions,
                                     fmi2Boolean visible, fmi2Boolean log)
{
    (void)name; (void)place; (void)functions; (void)visible; (void)log;
    if (type != fmi2CoSimulation || !stated || strcmp(stated, guid)) return NULL;
    vehicle *one = malloc(sizeof *one);
    if (one) settle(one);
    return one;
}

EXPORT void fmi2FreeInstance(fmi2Component c) { free(c); }

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean with_tolerance,
                                      fmi2Real tolerance, fmi2Real start, fmi2Boolean with_stop,
                                      fmi2Real stop)
{
    (void)with_tolerance; (void)tolerance; (void)with_stop; (void)stop;
    ((vehicle *)c)->t = start;
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }

EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    vehicle *one = c;
    ${name}_start(one->own, one->u, one->p, one->t, one->z);
    one->running = 1;
    return fmi2OK;
}

EXPORT fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }

EXPORT fmi2Status fmi2Reset(fmi2Component c)
{
    settle(c);
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[])
{
    vehicle *one = c;
    double y[MAX1(NY)];
    if (!one->running) ${name}_start(one->own, one->u, one->p, one->t, one->z);
    ${name}_measure(one->z, one->u, one->p, one->t, one->since, y, 0);
    for (size_t i = 0; i < n; ++i) {
        fmi2ValueReference k = r[i];
        if (k < NU) { v[i] = one->u[k]; continue; }
        if ((k -= NU) < NY) { v[i] = y[k]; continue; }
        if ((k -= NY) < NP) { v[i] = one->p[k]; continue; }
        if ((k -= NP) < NO) { v[i] = one->own[k]; continue; }
        if ((k -= NO) < NX) { v[i] = one->z[k]; continue; }
        return fmi2Error;
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
                              const fmi2Real v[])
{
    vehicle *one = c;
    for (size_t i = 0; i < n; ++i) {
        fmi2ValueReference k = r[i];
        if (k < NU) { one->u[k] = v[i]; continue; }
        if ((k -= NU) < NY) return fmi2Error;
        if ((k -= NY) < NP) { one->p[k] = v[i]; continue; }
        if ((k -= NP) < NO && !one->running) { one->own[k] = v[i]; continue; }
        return fmi2Error;
    }
    return fmi2OK;
}

/* One communication step: the sensors take in the measurement of its beginning, then it moves. */
EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real step, fmi2Boolean final)
{
    vehicle *one = c;
    double y[MAX1(NY)], check = 0.0;
    (void)final;
    if (!one->running || !(step > 0.0)) return fmi2Error;
    if (one->since == 1.0) one->since = step;
    ${name}_measure(one->z, one->u, one->p, t, one->since, y, 1);
    ${name}_advance(one->z, one->u, one->u, one->p, t, step);
    one->t = t + step;
    one->since = step;
    for (int i = 0; i < NX; ++i) check += one->z[i];
    return isfinite(check) ? fmi2OK : fmi2Error;
}

EXPORT fmi2Status fmi2CancelStep(fmi2Component c) { (void)c; return fmi2Error; }

EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (!*state) *state = malloc(sizeof(vehicle));
    if (!*state) return fmi2Error;
    memcpy(*state, c, sizeof(vehicle));
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    memcpy(c, state, sizeof(vehicle));
    return fmi2OK;
}

EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c; (void)state;
    *size = sizeof(vehicle);
    return fmi2OK;
}

EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[],
                                        size_t size)
{
    (void)c;
    if (size < sizeof(vehicle)) return fmi2Error;
    memcpy(bytes, state, sizeof(vehicle));
    return fmi2OK;
}

EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                          fmi2FMUstate *state)
{
    (void)c;
    if (size < sizeof(vehicle)) return fmi2Error;
    if (!*state) *state = malloc(sizeof(vehicle));
    if (!*state) return fmi2Error;
    memcpy(*state, bytes, sizeof(vehicle));
    return fmi2OK;
}

/* There are real variables only, and neither derivatives nor steps in the background. */
#define NONE(name, type)                                                                          \
    EXPORT fmi2Status name(fmi2Component c, const fmi2ValueReference r[], size_t n, type v)        \
    {                                                                                              \
        (void)c; (void)r; (void)v;                                                                 \
        return n ? fmi2Error : fmi2OK;                                                             \
    }
NONE(fmi2GetInteger, fmi2Integer *)
NONE(fmi2GetBoolean, fmi2Boolean *)
NONE(fmi2GetString, fmi2String *)
NONE(fmi2SetInteger, const fmi2Integer *)
NONE(fmi2SetBoolean, const fmi2Boolean *)
NONE(fmi2SetString, const fmi2String *)

EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[],
                                               size_t nu, const fmi2ValueReference k[], size_t nk,
                                               const fmi2Real dk[], fmi2Real du[])
{
    (void)c; (void)u; (void)nu; (void)k; (void)nk; (void)dk; (void)du;
    return fmi2Error;
}

EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[],
                                              size_t n, const fmi2Integer order[],
                                              const fmi2Real v[])
{
    (void)c; (void)r; (void)n; (void)order; (void)v;
    return fmi2Error;
}

EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[],
                                               size_t n, const fmi2Integer order[], fmi2Real v[])
{
    (void)c; (void)r; (void)n; (void)order; (void)v;
    return fmi2Error;
}

EXPORT fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *v)
{
    (void)c; (void)kind; (void)v;
    return fmi2Discard;
}

EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *v)
{
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *v = ((vehicle *)c)->t;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *v)
{
    (void)c; (void)kind; (void)v;
    return fmi2Discard;
}

EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *v)
{
    (void)c; (void)kind; (void)v;
    return fmi2Discard;
}

EXPORT fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *v)
{
    (void)c; (void)kind; (void)v;
    return fmi2Discard;
}
