/* $origin.
 *
 * SI units and radians. The order of states, inputs, outputs and parameters is that of the names
 * below. A state vector z holds the states first, then memory of actuators and sensors.
 */
#ifndef ${upper}_H
#define ${upper}_H

#ifdef __cplusplus
extern "C" {
#endif

enum {
    ${upper}_STATES = $nx,      /* states */
    ${upper}_OWN = $own,        /* of these, states that a start is given for */
    ${upper}_FULL = $nz,        /* length of z */
    ${upper}_INPUTS = $nu,
    ${upper}_OUTPUTS = $ny,
    ${upper}_PARAMETERS = $np,
    ${upper}_ESTIMATED = $nf
};

/* Longest integration step, s. */
#define ${upper}_STEP $step

extern const char *const ${name}_state_names[];
extern const char *const ${name}_input_names[];
extern const char *const ${name}_output_names[];
extern const char *const ${name}_parameter_names[];
extern const double ${name}_values[];             /* parameters, as estimated */
extern const char *const ${name}_estimated_names[];
extern const double ${name}_covariance[];         /* of the estimated ones, row by row */

/* z at the start, from the own states and the first inputs. */
void ${name}_start(const double *own, const double *u, const double *p, double t, double *z);

/* Outputs at time t; h is the time since the last measurement. With remember, sensors with memory
 * take the measurement in, once per sample; between samples advance has them take in each step. */
void ${name}_measure(double *z, const double *u, const double *p, double t, double h, double *y,
                     int remember);

/* Rates of the states at time t, for an integrator of your own; actuators that remember act as over
 * one STEP. */
void ${name}_rates(const double *z, const double *u, const double *p, double t, double *dx);

/* From t to t + interval; u at the beginning and, for inputs that are interpolated, at the end. */
void ${name}_advance(double *z, const double *u, const double *u_end, const double *p, double t,
                     double interval);

/* Outputs (n x OUTPUTS) for inputs (n x INPUTS) at times (n). Returns -1, or the first sample at
 * which the state is no longer finite. */
int ${name}_simulate(int n, const double *times, const double *inputs, const double *own,
                     const double *p, double *outputs);

#ifdef __cplusplus
}
#endif
#endif
