/* $origin.
 *
 * Repeats a trajectory of the package: cc -O2 ${name}.c ${name}_test.c -lm && ./a.out
 * Prints the largest difference relative to the largest value of each output; ends with 0 if it
 * is below $tolerance.
 */
#include "$name.h"

#include <math.h>
#include <stdio.h>

#define N $n

static const double times[] = {
    $times
};
static const double inputs[] = {
    $inputs
};
static const double own[] = {
    $own
};
static const double parameters[] = {
    $parameters
};
static const double expected[] = {
    $expected
};
static double found[N * ${upper}_OUTPUTS];

int main(void)
{
    double worst = 0.0;
    const int failed = ${name}_simulate(N, times, inputs, own, parameters, found);
    if (failed >= 0) {
        printf("the state is not finite at sample %d\n", failed);
        return 2;
    }
    for (int j = 0; j < ${upper}_OUTPUTS; ++j) {
        double largest = 1e-300, difference = 0.0;
        for (int k = 0; k < N; ++k) {
            const double value = expected[k * ${upper}_OUTPUTS + j];
            const double away = fabs(found[k * ${upper}_OUTPUTS + j] - value);
            if (fabs(value) > largest) largest = fabs(value);
            if (!(away <= difference)) difference = away;
        }
        if (!(difference / largest <= worst)) worst = difference / largest;
    }
    printf("%d samples, largest relative difference %.3g\n", N, worst);
    return worst < $tolerance ? 0 : 1;
}
