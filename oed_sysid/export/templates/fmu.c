/* $origin.
 *
 * Functional Mock-up Unit around ${name}.c, one instance a vehicle: what both versions of the
 * interface share, then the functions of FMI $version. Value references: 0 to NU - 1 inputs, then
 * outputs, parameters, start values of the own states, states, their derivatives, and the time.
 */
#include "$name.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

#define NU ${upper}_INPUTS
#define NY ${upper}_OUTPUTS
#define NP ${upper}_PARAMETERS
#define NO ${upper}_OWN
#define NX ${upper}_STATES
#define MAX1(n) ((n) > 0 ? (n) : 1)
/* Memory of sampled actuators and sensors is no continuous state: such a unit steps by itself. */
#define EXCHANGES $exchanges
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

static void *created(const char *stated, int known)
{
    vehicle *one = known && stated && !strcmp(stated, guid) ? malloc(sizeof *one) : NULL;
    if (one) settle(one);
    return one;
}

static void begin(vehicle *one)
{
    ${name}_start(one->own, one->u, one->p, one->t, one->z);
    one->running = 1;
}

static int read_values(vehicle *one, const unsigned int r[], size_t n, double v[])
{
    double y[MAX1(NY)], dx[MAX1(NX)];
    if (!one->running) ${name}_start(one->own, one->u, one->p, one->t, one->z);
    ${name}_measure(one->z, one->u, one->p, one->t, one->since, y, 0);
    ${name}_rates(one->z, one->u, one->p, one->t, dx);
    for (size_t i = 0; i < n; ++i) {
        unsigned int k = r[i];
        if (k < NU) { v[i] = one->u[k]; continue; }
        if ((k -= NU) < NY) { v[i] = y[k]; continue; }
        if ((k -= NY) < NP) { v[i] = one->p[k]; continue; }
        if ((k -= NP) < NO) { v[i] = one->own[k]; continue; }
        if ((k -= NO) < NX) { v[i] = one->z[k]; continue; }
        if ((k -= NX) < NX) { v[i] = dx[k]; continue; }
        if (k == NX) { v[i] = one->t; continue; }
        return 0;
    }
    return 1;
}

static int write_values(vehicle *one, const unsigned int r[], size_t n, const double v[])
{
    for (size_t i = 0; i < n; ++i) {
        unsigned int k = r[i];
        if (k < NU) { one->u[k] = v[i]; continue; }
        if ((k -= NU) < NY) return 0;
        if ((k -= NY) < NP) { one->p[k] = v[i]; continue; }
        if ((k -= NP) < NO && !one->running) { one->own[k] = v[i]; continue; }
        return 0;
    }
    return 1;
}

/* One communication step: the sensors take in the measurement of its beginning, then it moves. */
static int move(vehicle *one, double t, double step)
{
    double y[MAX1(NY)], check = 0.0;
    if (!one->running || !(step > 0.0)) return 0;
    if (one->since == 1.0) one->since = step;
    ${name}_measure(one->z, one->u, one->p, t, one->since, y, 1);
    ${name}_advance(one->z, one->u, one->u, one->p, t, step);
    one->t = t + step;
    one->since = step;
    for (int i = 0; i < NX; ++i) check += one->z[i];
    return isfinite(check) != 0;
}

static int kept(const vehicle *one, void **state)
{
    if (!*state) *state = malloc(sizeof(vehicle));
    if (*state) memcpy(*state, one, sizeof(vehicle));
    return *state != NULL;
}

/* What the importer integrates in model exchange; there are no events but those of the inputs. */
#define EXCHANGED(v, Instance, Real, Boolean, rates)                                               \
    EXPORT v##Status v##CompletedIntegratorStep(Instance c, Boolean final, Boolean *event,         \
                                                Boolean *terminate)                                \
    {                                                                                              \
        (void)c; (void)final;                                                                      \
        *event = *terminate = 0;                                                                   \
        return v##OK;                                                                              \
    }                                                                                              \
    EXPORT v##Status v##SetTime(Instance c, Real t)                                                \
    {                                                                                              \
        ((vehicle *)c)->t = t;                                                                     \
        return v##OK;                                                                              \
    }                                                                                              \
    EXPORT v##Status v##SetContinuousStates(Instance c, const Real x[], size_t n)                  \
    {                                                                                              \
        if (n != NX) return v##Error;                                                              \
        memcpy(((vehicle *)c)->z, x, sizeof(double) * NX);                                         \
        return v##OK;                                                                              \
    }                                                                                              \
    EXPORT v##Status v##GetContinuousStates(Instance c, Real x[], size_t n)                        \
    {                                                                                              \
        if (n != NX) return v##Error;                                                              \
        memcpy(x, ((vehicle *)c)->z, sizeof(double) * NX);                                         \
        return v##OK;                                                                              \
    }                                                                                              \
    EXPORT v##Status rates(Instance c, Real dx[], size_t n)                                        \
    {                                                                                              \
        vehicle *one = c;                                                                          \
        if (n != NX) return v##Error;                                                              \
        ${name}_rates(one->z, one->u, one->p, one->t, dx);                                         \
        return v##OK;                                                                              \
    }                                                                                              \
    EXPORT v##Status v##GetNominalsOfContinuousStates(Instance c, Real x[], size_t n)              \
    {                                                                                              \
        (void)c;                                                                                   \
        for (size_t i = 0; i < n; ++i) x[i] = 1.0;                                                 \
        return v##OK;                                                                              \
    }                                                                                              \
    EXPORT v##Status v##GetEventIndicators(Instance c, Real x[], size_t n)                         \
    {                                                                                              \
        (void)c; (void)x;                                                                          \
        return n ? v##Error : v##OK;                                                               \
    }

/* State of an instance, kept, put back and as bytes. */
#define KEPT(v, Instance, State, Byte, name, restore)                                              \
    EXPORT v##Status v##Get##name(Instance c, State *state)                                        \
    {                                                                                              \
        return kept(c, state) ? v##OK : v##Error;                                                  \
    }                                                                                              \
    EXPORT v##Status v##Set##name(Instance c, State state)                                         \
    {                                                                                              \
        memcpy(c, state, sizeof(vehicle));                                                         \
        return v##OK;                                                                              \
    }                                                                                              \
    EXPORT v##Status v##Free##name(Instance c, State *state)                                       \
    {                                                                                              \
        (void)c;                                                                                   \
        free(*state);                                                                              \
        *state = NULL;                                                                             \
        return v##OK;                                                                              \
    }                                                                                              \
    EXPORT v##Status v##Serialized##name##Size(Instance c, State state, size_t *size)              \
    {                                                                                              \
        (void)c; (void)state;                                                                      \
        *size = sizeof(vehicle);                                                                   \
        return v##OK;                                                                              \
    }                                                                                              \
    EXPORT v##Status v##Serialize##name(Instance c, State state, Byte bytes[], size_t size)        \
    {                                                                                              \
        (void)c;                                                                                   \
        if (size < sizeof(vehicle)) return v##Error;                                               \
        memcpy(bytes, state, sizeof(vehicle));                                                     \
        return v##OK;                                                                              \
    }                                                                                              \
    EXPORT v##Status restore(Instance c, const Byte bytes[], size_t size, State *state)            \
    {                                                                                              \
        (void)c;                                                                                   \
        if (size < sizeof(vehicle)) return v##Error;                                               \
        return kept((const vehicle *)(const void *)bytes, state) ? v##OK : v##Error;               \
    }

$functions