/* $origin. */
#include "$name.h"

#include <math.h>
#include <string.h>

#define NX ${upper}_STATES
#define NA $na
#define NS $ns
#define NU ${upper}_INPUTS
#define NY ${upper}_OUTPUTS
#define ND $nd
#define MAX1(n) ((n) > 0 ? (n) : 1)
#define ANY_LINEAR $any_linear

const char *const ${name}_state_names[] = {$states};
const char *const ${name}_input_names[] = {$inputs};
const char *const ${name}_output_names[] = {$outputs};
const char *const ${name}_parameter_names[] = {$parameters};
const char *const ${name}_estimated_names[] = {$free};
const double ${name}_values[] = {
    $values
};
const double ${name}_covariance[] = {
    $covariance
};

static const int linear_input[] = {$linear};

$functions

/* Inputs at a fraction of the way between two moments; held ones stay. */
static void between(const double *from, const double *to, double fraction, double *u)
{
    for (int i = 0; i < NU; ++i)
        u[i] = linear_input[i] ? from[i] + fraction * (to[i] - from[i]) : from[i];
}

$advance

/* Equal steps of an interval, none longer than STEP. */
static int steps_within(double interval)
{
    const int steps = (int)ceil(interval / ${upper}_STEP - 1e-9);
    return steps < 1 ? 1 : steps;
}

void ${name}_start(const double *own, const double *u, const double *p, double t, double *z)
{
    start(own, u, p, t, z);
}

void ${name}_measure(double *z, const double *u, const double *p, double t, double h, double *y,
                     int remember)
{
    double d[MAX1(ND)], discard[MAX1(NA)], next[MAX1(NS)];
    h /= steps_within(h); /* sensors last took in the beginning of the step before */
    actuate(z + NX, u, p, t, h, d, discard);
    observe(z, d, z + NX + NA, p, t, h, y, next);
    if (remember)
        for (int i = 0; i < NS; ++i) z[NX + NA + i] = next[i];
}

void ${name}_rates(const double *z, const double *u, const double *p, double t, double *dx)
{
    double d[MAX1(ND)], discard[MAX1(NA)];
    actuate(z + NX, u, p, t, ${upper}_STEP, d, discard);
    rates(z, d, p, t, dx);
}

void ${name}_advance(double *z, const double *u, const double *u_end, const double *p, double t,
                     double interval)
{
    const int steps = steps_within(interval);
    const double h = interval / steps;
    double from[MAX1(NU)], to[MAX1(NU)], y[MAX1(NY)];
    for (int i = 0; i < steps; ++i) {
        between(u, u_end, (double)i / steps, from);
        between(u, u_end, (double)(i + 1) / steps, to);
        if (NS > 0 && i > 0) ${name}_measure(z, from, p, t + i * h, h, y, 1);
        one_step(z, from, to, p, t + i * h, h);
    }
}

int ${name}_simulate(int n, const double *times, const double *inputs, const double *own,
                     const double *p, double *outputs)
{
    double z[MAX1(${upper}_FULL)];
    if (n < 1) return -1;
    start(own, inputs, p, times[0], z);
    for (int k = 0; k < n; ++k) {
        const double *u = inputs + k * NU;
        const double since = k ? times[k] - times[k - 1] : (n > 1 ? times[1] - times[0] : 1.0);
        double check = 0.0;
        for (int i = 0; i < ${upper}_FULL; ++i) check += z[i];
        if (!isfinite(check)) return k;
        ${name}_measure(z, u, p, times[k], since, outputs + k * NY, 1);
        if (k + 1 < n)
            ${name}_advance(z, u, u + NU, p, times[k], times[k + 1] - times[k]);
    }
    return -1;
}
