/* The bare limit: the compiled kernel called in a loop from C, into buffers that stay.
 *
 *   kernel_loop LIBRARY DATA REPEATS
 *
 * DATA: ints n, n_inputs, n_parameters, n_full, n_outputs, n_columns; then doubles step,
 * times, inputs, values, start state. Prints the least processor time of a call, s, and a
 * checksum of the sensitivities.
 */
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

typedef int (*run_t)(int, const double *, const double *, const double *, double, int,
                     const int *, const double *, int, double *, double *, double *, double *,
                     double *);

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static double *numbers(FILE *file, size_t count)
{
    double *result = malloc(sizeof(double) * count);
    if (!result || fread(result, sizeof(double), count, file) != count) exit(3);
    return result;
}

int main(int argc, char **argv)
{
    if (argc != 4) return 2;
    void *library = dlopen(argv[1], RTLD_NOW);
    FILE *file = fopen(argv[2], "rb");
    if (!library || !file) return 3;
    run_t run = (run_t)dlsym(library, "kernel_run");
    int size[6];
    if (!run || fread(size, sizeof(int), 6, file) != 6) return 3;
    const int n = size[0], nu = size[1], np = size[2], nz = size[3], ny = size[4], nc = size[5];
    const double *step = numbers(file, 1), *times = numbers(file, n);
    const double *inputs = numbers(file, (size_t)n * nu), *values = numbers(file, np);
    const double *node = numbers(file, nz);
    double *z = malloc(sizeof(double) * n * nz), *y = malloc(sizeof(double) * n * ny);
    double *dy = malloc(sizeof(double) * n * ny * nc), *end = malloc(sizeof(double) * nz);
    double *dend = malloc(sizeof(double) * nz * nc);
    const int first = 0;
    double best = 1e9;
    for (int i = 0; i < atoi(argv[3]); ++i) {
        const double began = now();
        const int failed = run(n, times, inputs, values, *step, 1, &first, node, 0, z, y, dy, end,
                               dend);
        const double taken = now() - began;
        if (failed >= 0) return 4;
        if (taken < best) best = taken;
    }
    double sum = 0.0;
    for (size_t i = 0; i < (size_t)n * ny * nc; ++i) sum += dy[i];
    printf("%.9g %.17g\n", best, sum);
    return 0;
}
