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
    return created(stated, type == fmi2CoSimulation || EXCHANGES);
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
    begin(c);
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
    return read_values(c, r, n, v) ? fmi2OK : fmi2Error;
}

EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
                              const fmi2Real v[])
{
    return write_values(c, r, n, v) ? fmi2OK : fmi2Error;
}

EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real step, fmi2Boolean final)
{
    (void)final;
    return move(c, t, step) ? fmi2OK : fmi2Error;
}

/* Model exchange: the importer integrates; there are no events but those of the inputs. */
typedef struct {
    fmi2Boolean again, terminate, nominals, values, timed;
    fmi2Real next;
} fmi2EventInfo;

EXPORT fmi2Status fmi2EnterEventMode(fmi2Component c) { (void)c; return fmi2OK; }
EXPORT fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { (void)c; return fmi2OK; }
EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *event)
{
    (void)c;
    memset(event, 0, sizeof *event);
    return fmi2OK;
}

EXCHANGED(fmi2, fmi2Component, fmi2Real, fmi2Boolean, fmi2GetDerivatives)
KEPT(fmi2, fmi2Component, fmi2FMUstate, fmi2Byte, FMUstate, fmi2DeSerializeFMUstate)

EXPORT fmi2Status fmi2CancelStep(fmi2Component c) { (void)c; return fmi2Error; }

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
