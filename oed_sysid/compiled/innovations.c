/* Innovations of linear deviations under a noise model that admits model error.
 *
 * Sizes are macros: NX state deviations, NF coloured forces, NY outputs, of
 * which each also has a coloured sensor disturbance when COLOUR is 1.
 * The Kalman filter runs once; its gains whiten any number of columns.
 *
 *   x+ = A x + G f,  f+ = pf f + noise,  c+ = pc c + noise,  y = C x + c + v
 */

#include <math.h>
#include <string.h>

#define NC_ (COLOUR ? NY : 0)
#define N (NX + NF + NC_)

/* Returns 0, or 1 when an innovation covariance is not positive definite.
 *
 * n times; a (n x NX x NX) transition to the next sample; g (n x NX x NF);
 * c (n x NY x NX); present (n x NY) 1 where measured;
 * force_var, force_memory (NF), colour_var (NY), colour_memory (NY), white_var (NY);
 * columns (n x NY x m) are whitened in place (0 where not measured);
 * roots (n x NY) receives the standard deviation of each innovation given those
 * before it (1 where not measured), so that log|S| is twice the sum of its logs.
 */
int innovations(int n, int m, const double *a, const double *g, const double *c,
                const double *present, const double *force_var, const double *force_memory,
                const double *colour_var, const double *colour_memory, const double *white_var,
                double *columns, double *work, double *roots)
{
    double p[N][N], fp[N][N], f[N][N], h[NY][N], hp[NY][N], s[NY][NY], gain[NY][N];
    double *x = work;            /* N x m: filtered columns */
    double *next = work + N * m; /* N x m */
    memset(p, 0, sizeof p);
    memset(f, 0, sizeof f);
    memset(h, 0, sizeof h);
    memset(x, 0, sizeof(double) * N * m);
    for (int i = 0; i < NF; ++i) {
        p[NX + i][NX + i] = force_var[i];
        f[NX + i][NX + i] = force_memory[i];
    }
    for (int i = 0; i < NC_; ++i) {
        p[NX + NF + i][NX + NF + i] = colour_var[i];
        f[NX + NF + i][NX + NF + i] = colour_memory[i];
        h[i][NX + NF + i] = 1.0;
    }
    for (int k = 0; k < n; ++k) {
        const double *ck = c + (size_t)k * NY * NX;
        double *e = columns + (size_t)k * NY * m;
        for (int i = 0; i < NY; ++i)
            for (int j = 0; j < NX; ++j) h[i][j] = ck[i * NX + j];
        memset(hp, 0, sizeof hp);
        for (int i = 0; i < NY; ++i)
            for (int l = 0; l < N; ++l) {
                const double v = h[i][l];
                if (v != 0.0)
                    for (int j = 0; j < N; ++j) hp[i][j] += v * p[l][j];
            }
        for (int i = 0; i < NY; ++i)
            for (int j = 0; j < NY; ++j) {
                double v = i == j ? white_var[i] : 0.0;
                for (int l = 0; l < N; ++l) v += hp[i][l] * h[j][l];
                s[i][j] = v;
            }
        /* A missing sample carries no information: cut it from the update. */
        for (int i = 0; i < NY; ++i)
            if (present[(size_t)k * NY + i] == 0.0) {
                for (int j = 0; j < NY; ++j) s[i][j] = s[j][i] = 0.0;
                s[i][i] = 1.0;
                memset(hp[i], 0, sizeof hp[i]);
            }
        /* e <- L^-1 (e - H x), gain <- L^-1 H P, by Cholesky of s, row by row. */
        for (int i = 0; i < NY; ++i) {
            const int seen = present[(size_t)k * NY + i] != 0.0;
            double *ei = e + (size_t)i * m;
            if (!seen) memset(ei, 0, sizeof(double) * m);
            else
                for (int l = 0; l < N; ++l) {
                    const double v = h[i][l];
                    if (v != 0.0)
                        for (int j = 0; j < m; ++j) ei[j] -= v * x[l * m + j];
                }
            for (int j = 0; j < N; ++j) gain[i][j] = hp[i][j];
            double pivot = s[i][i];
            for (int l = 0; l < i; ++l) {
                const double v = s[i][l];
                pivot -= v * v;
                if (v != 0.0) {
                    const double *el = e + (size_t)l * m;
                    for (int j = 0; j < m; ++j) ei[j] -= v * el[j];
                    for (int j = 0; j < N; ++j) gain[i][j] -= v * gain[l][j];
                }
            }
            if (!(pivot > 0.0)) return 1;
            const double root = sqrt(pivot), inverse = 1.0 / root;
            s[i][i] = root;
            roots[(size_t)k * NY + i] = seen ? root : 1.0;
            for (int j = 0; j < m; ++j) ei[j] *= inverse;
            for (int j = 0; j < N; ++j) gain[i][j] *= inverse;
            for (int r = i + 1; r < NY; ++r) {
                double v = s[r][i];
                for (int l = 0; l < i; ++l) v -= s[r][l] * s[i][l];
                s[r][i] = v * inverse;
            }
        }
        if (k + 1 == n) break;
        /* Measurement update, then prediction. */
        for (int i = 0; i < NY; ++i) {
            const double *ei = e + (size_t)i * m;
            for (int l = 0; l < N; ++l) {
                const double v = gain[i][l];
                if (v != 0.0) {
                    double *xl = x + (size_t)l * m;
                    for (int j = 0; j < m; ++j) xl[j] += v * ei[j];
                    for (int j = 0; j < N; ++j) p[l][j] -= v * gain[i][j];
                }
            }
        }
        const double *ak = a + (size_t)k * NX * NX, *gk = g + (size_t)k * NX * NF;
        for (int i = 0; i < NX; ++i) {
            for (int j = 0; j < NX; ++j) f[i][j] = ak[i * NX + j];
            for (int j = 0; j < NF; ++j) f[i][NX + j] = gk[i * NF + j];
        }
        memset(fp, 0, sizeof fp);
        memset(next, 0, sizeof(double) * N * m);
        for (int i = 0; i < N; ++i)
            for (int l = 0; l < N; ++l) {
                const double v = f[i][l];
                if (v != 0.0) {
                    for (int j = 0; j < N; ++j) fp[i][j] += v * p[l][j];
                    for (int j = 0; j < m; ++j) next[(size_t)i * m + j] += v * x[(size_t)l * m + j];
                }
            }
        double *swap = x;
        x = next;
        next = swap;
        for (int i = 0; i < N; ++i)
            for (int j = 0; j <= i; ++j) {
                double v = 0.0;
                for (int l = 0; l < N; ++l) v += fp[i][l] * f[j][l];
                p[i][j] = p[j][i] = v;
            }
        for (int i = 0; i < NF; ++i)
            p[NX + i][NX + i] += force_var[i] * (1.0 - force_memory[i] * force_memory[i]);
        for (int i = 0; i < NC_; ++i)
            p[NX + NF + i][NX + NF + i] += colour_var[i] * (1.0 - colour_memory[i] * colour_memory[i]);
    }
    return 0;
}
