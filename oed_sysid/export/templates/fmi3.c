/* Types as the standard declares them. */
typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef double fmi3Float64;
typedef bool fmi3Boolean, fmi3Clock;
typedef uint8_t fmi3Byte;
typedef const char *fmi3String;
typedef const fmi3Byte *fmi3Binary;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef void (*fmi3Callback)(void);

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n,
                                      const fmi3String categories[])
{
    (void)c; (void)on; (void)n; (void)categories;
    return fmi3OK;
}

EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String place,
                                                 fmi3Boolean visible, fmi3Boolean log,
                                                 fmi3InstanceEnvironment environment,
                                                 fmi3Callback message)
{
    (void)name; (void)place; (void)visible; (void)log; (void)environment; (void)message;
    return created(token, EXCHANGES);
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String place,
                                                fmi3Boolean visible, fmi3Boolean log,
                                                fmi3Boolean events, fmi3Boolean early,
                                                const fmi3ValueReference r[], size_t n,
                                                fmi3InstanceEnvironment environment,
                                                fmi3Callback message, fmi3Callback update)
{
    (void)name; (void)place; (void)visible; (void)log; (void)events; (void)early; (void)r; (void)n;
    (void)environment; (void)message; (void)update;
    return created(token, 1);
}

EXPORT fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token,
                                                      fmi3String place, fmi3Boolean visible,
                                                      fmi3Boolean log,
                                                      fmi3InstanceEnvironment environment,
                                                      fmi3Callback message, fmi3Callback clock,
                                                      fmi3Callback lock, fmi3Callback unlock)
{
    (void)name; (void)token; (void)place; (void)visible; (void)log; (void)environment;
    (void)message; (void)clock; (void)lock; (void)unlock;
    return NULL;
}

EXPORT void fmi3FreeInstance(fmi3Instance c) { free(c); }

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean with_tolerance,
                                              fmi3Float64 tolerance, fmi3Float64 start,
                                              fmi3Boolean with_stop, fmi3Float64 stop)
{
    (void)with_tolerance; (void)tolerance; (void)with_stop; (void)stop;
    ((vehicle *)c)->t = start;
    return fmi3OK;
}

EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    begin(c);
    return fmi3OK;
}

EXPORT fmi3Status fmi3Reset(fmi3Instance c)
{
    settle(c);
    return fmi3OK;
}

/* Modes that have nothing to do: there are no events but those of the inputs. */
#define PASSES(name) EXPORT fmi3Status name(fmi3Instance c) { (void)c; return fmi3OK; }
PASSES(fmi3EnterEventMode)
PASSES(fmi3EnterContinuousTimeMode)
PASSES(fmi3EnterStepMode)
PASSES(fmi3EnterConfigurationMode)
PASSES(fmi3ExitConfigurationMode)
PASSES(fmi3EvaluateDiscreteStates)
PASSES(fmi3Terminate)

EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again,
                                           fmi3Boolean *terminate, fmi3Boolean *nominals,
                                           fmi3Boolean *values, fmi3Boolean *timed,
                                           fmi3Float64 *next)
{
    (void)c; (void)next;
    *again = *terminate = *nominals = *values = *timed = false;
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n,
                                 fmi3Float64 v[], size_t length)
{
    return length == n && read_values(c, r, n, v) ? fmi3OK : fmi3Error;
}

EXPORT fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n,
                                 const fmi3Float64 v[], size_t length)
{
    return length == n && write_values(c, r, n, v) ? fmi3OK : fmi3Error;
}

/* There are real variables only. */
#define NONE(kind, type)                                                                           \
    EXPORT fmi3Status fmi3Get##kind(fmi3Instance c, const fmi3ValueReference r[], size_t n,        \
                                    type v[], size_t length)                                       \
    {                                                                                              \
        (void)c; (void)r; (void)v; (void)length;                                                   \
        return n ? fmi3Error : fmi3OK;                                                             \
    }                                                                                              \
    EXPORT fmi3Status fmi3Set##kind(fmi3Instance c, const fmi3ValueReference r[], size_t n,        \
                                    const type v[], size_t length)                                 \
    {                                                                                              \
        (void)c; (void)r; (void)v; (void)length;                                                   \
        return n ? fmi3Error : fmi3OK;                                                             \
    }
NONE(Float32, float)
NONE(Int8, int8_t)
NONE(UInt8, uint8_t)
NONE(Int16, int16_t)
NONE(UInt16, uint16_t)
NONE(Int32, int32_t)
NONE(UInt32, uint32_t)
NONE(Int64, int64_t)
NONE(UInt64, uint64_t)
NONE(Boolean, fmi3Boolean)
NONE(String, fmi3String)

EXPORT fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t n,
                                size_t sizes[], fmi3Binary v[], size_t length)
{
    (void)c; (void)r; (void)sizes; (void)v; (void)length;
    return n ? fmi3Error : fmi3OK;
}

EXPORT fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t n,
                                const size_t sizes[], const fmi3Binary v[], size_t length)
{
    (void)c; (void)r; (void)sizes; (void)v; (void)length;
    return n ? fmi3Error : fmi3OK;
}

/* Neither clocks nor derivatives of outputs nor dependencies. */
#define WITHOUT(name, type)                                                                        \
    EXPORT fmi3Status name(fmi3Instance c, const fmi3ValueReference r[], size_t n, type v)         \
    {                                                                                              \
        (void)c; (void)r; (void)v;                                                                 \
        return n ? fmi3Error : fmi3OK;                                                             \
    }
#define WITHOUT_TWO(name, first, second)                                                           \
    EXPORT fmi3Status name(fmi3Instance c, const fmi3ValueReference r[], size_t n, first v,        \
                           second w)                                                               \
    {                                                                                              \
        (void)c; (void)r; (void)v; (void)w;                                                        \
        return n ? fmi3Error : fmi3OK;                                                             \
    }
WITHOUT(fmi3GetClock, fmi3Clock *)
WITHOUT(fmi3SetClock, const fmi3Clock *)
WITHOUT(fmi3GetShiftDecimal, fmi3Float64 *)
WITHOUT(fmi3SetShiftDecimal, const fmi3Float64 *)
WITHOUT(fmi3SetIntervalDecimal, const fmi3Float64 *)
WITHOUT_TWO(fmi3GetIntervalDecimal, fmi3Float64 *, int *)
WITHOUT_TWO(fmi3GetShiftFraction, uint64_t *, uint64_t *)
WITHOUT_TWO(fmi3SetShiftFraction, const uint64_t *, const uint64_t *)
WITHOUT_TWO(fmi3SetIntervalFraction, const uint64_t *, const uint64_t *)

EXPORT fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference r[], size_t n,
                                          uint64_t counters[], uint64_t resolutions[],
                                          int qualifiers[])
{
    (void)c; (void)r; (void)counters; (void)resolutions; (void)qualifiers;
    return n ? fmi3Error : fmi3OK;
}

EXPORT fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference r[], size_t n,
                                           const int32_t orders[], fmi3Float64 v[], size_t length)
{
    (void)c; (void)r; (void)orders; (void)v; (void)length;
    return n ? fmi3Error : fmi3OK;
}

EXPORT fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference r,
                                                      size_t *n)
{
    (void)c; (void)r; (void)n;
    return fmi3Error;
}

EXPORT fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference r, size_t of[],
                                              fmi3ValueReference on[], size_t of_on[], int kinds[],
                                              size_t n)
{
    (void)c; (void)r; (void)of; (void)on; (void)of_on; (void)kinds; (void)n;
    return fmi3Error;
}

#define NO_SLOPES(name)                                                                            \
    EXPORT fmi3Status name(fmi3Instance c, const fmi3ValueReference u[], size_t nu,                \
                           const fmi3ValueReference k[], size_t nk, const fmi3Float64 seed[],      \
                           size_t ns, fmi3Float64 v[], size_t n)                                   \
    {                                                                                              \
        (void)c; (void)u; (void)nu; (void)k; (void)nk; (void)seed; (void)ns; (void)v; (void)n;     \
        return fmi3Error;                                                                          \
    }
NO_SLOPES(fmi3GetDirectionalDerivative)
NO_SLOPES(fmi3GetAdjointDerivative)

EXPORT fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 t)
{
    (void)c; (void)clock; (void)t;
    return fmi3Error;
}

EXCHANGED(fmi3, fmi3Instance, fmi3Float64, fmi3Boolean, fmi3GetContinuousStateDerivatives)
KEPT(fmi3, fmi3Instance, fmi3FMUState, fmi3Byte, FMUState, fmi3DeserializeFMUState)

EXPORT fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n)
{
    (void)c;
    *n = 0;
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n)
{
    (void)c;
    *n = NX;
    return fmi3OK;
}

EXPORT fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 step, fmi3Boolean final,
                             fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early,
                             fmi3Float64 *last)
{
    (void)final;
    *event = *terminate = *early = false;
    const int moved = move(c, t, step);
    *last = ((vehicle *)c)->t;
    return moved ? fmi3OK : fmi3Error;
}
