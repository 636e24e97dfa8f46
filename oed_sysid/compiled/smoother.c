/* Smoothed disturbances and state deviations of a linear model under a noise model.
 *
 * Same system and macros as innovations.c: NX state deviations, NF coloured
 * forces, NY outputs, of which each has a coloured disturbance when COLOUR is 1.
 *
 *   x+ = A x + G f,  f+ = pf f + noise,  c+ = pc c + noise,  y = C x + c + v
 *
 * A Kalman filter runs forward and keeps what a disturbance smoother (de Jong
 * 1989) needs on its way back; no state covariance is inverted.
 */

#include <math.h>
#include <string.h>

#define NC_ (COLOUR ? NY : 0)
#define N (NX + NF + NC_)
/* Kept per time: gain and output rows NY x N each, covariance N x N. */
#define KEPT (2 * NY * N + N * N)

static void system_matrix(double f[N][N], const double *a, const double *g)
{
    for (int i = 0; i < NX; ++i) {
        for (int j = 0; j < NX; ++j) f[i][j] = a[i * NX + j];
        for (int j = 0; j < NF; ++j) f[i][NX + j] = g[i * NF + j];
    }
}

/* Returns 0, or 1 when an innovation covariance is not positive definite.
 *
 * n times, m columns; a, g, c, present and variances as in innovations.c;
 * columns (n x NY x m) are whitened in place, 0 where not measured;
 * states (n x N x m) receives the smoothed full state of each column;
 * variance (n x NF) what is left of the forces' variance;
 * kept (n x KEPT) and work (N x (m + 1)) are scratch.
 */
int smoother(int n, int m, const double *a, const double *g, const double *c,
             const double *present, const double *force_var, const double *force_memory,
             const double *colour_var, const double *colour_memory, const double *white_var,
             double *columns, double *states, double *variance, double *kept, double *work)
{
    double p[N][N], fp[N][N], f[N][N], h[NY][N], s[NY][NY];
    memset(p, 0, sizeof p);
    memset(f, 0, sizeof f);
    memset(h, 0, sizeof h);
    memset(states, 0, sizeof(double) * N * m);
    for (int i = 0; i < NF; ++i) {
        p[NX + i][NX + i] = force_var[i];
        f[NX + i][NX + i] = force_memory[i];
    }
    for (int i = 0; i < NC_; ++i) {
        p[NX + NF + i][NX + NF + i] = colour_var[i];
        f[NX + NF + i][NX + NF + i] = colour_memory[i];
    }
    for (int k = 0; k < n; ++k) {
        double *gain = kept + (size_t)k * KEPT, *rows = gain + NY * N;
        double *e = columns + (size_t)k * NY * m, *x = states + (size_t)k * N * m;
        const double *ck = c + (size_t)k * NY * NX, *seen = present + (size_t)k * NY;
        memcpy(rows + NY * N, p, sizeof p);
        for (int i = 0; i < NY; ++i) {
            memset(h[i], 0, sizeof h[i]);
            if (seen[i] == 0.0) continue;
            for (int j = 0; j < NX; ++j) h[i][j] = ck[i * NX + j];
            if (COLOUR) h[i][NX + NF + (i < NC_ ? i : 0)] = 1.0;
        }
        for (int i = 0; i < NY; ++i)
            for (int j = 0; j < N; ++j) {
                double v = 0.0;
                for (int l = 0; l < N; ++l) v += h[i][l] * p[l][j];
                gain[i * N + j] = v;
                rows[i * N + j] = h[i][j];
            }
        for (int i = 0; i < NY; ++i)
            for (int j = 0; j <= i; ++j) {
                double v = i == j ? (seen[i] != 0.0 ? white_var[i] : 1.0) : 0.0;
                for (int l = 0; l < N; ++l) v += gain[i * N + l] * h[j][l];
                s[i][j] = s[j][i] = v;
            }
        /* e, gain and rows times the inverse Cholesky factor of s. */
        for (int i = 0; i < NY; ++i) {
            double *ei = e + (size_t)i * m;
            for (int l = 0; l < N; ++l)
                if (h[i][l] != 0.0)
                    for (int j = 0; j < m; ++j) ei[j] -= h[i][l] * x[(size_t)l * m + j];
            if (seen[i] == 0.0) memset(ei, 0, sizeof(double) * m);
            double pivot = s[i][i];
            for (int l = 0; l < i; ++l) {
                const double v = s[i][l];
                if (v == 0.0) continue;
                pivot -= v * v;
                for (int j = 0; j < m; ++j) ei[j] -= v * e[(size_t)l * m + j];
                for (int j = 0; j < N; ++j) {
                    gain[i * N + j] -= v * gain[l * N + j];
                    rows[i * N + j] -= v * rows[l * N + j];
                }
            }
            if (!(pivot > 0.0)) return 1;
            const double inverse = 1.0 / sqrt(pivot);
            for (int j = 0; j < m; ++j) ei[j] *= inverse;
            for (int j = 0; j < N; ++j) {
                gain[i * N + j] *= inverse;
                rows[i * N + j] *= inverse;
            }
            for (int r = i + 1; r < NY; ++r) {
                double v = s[r][i];
                for (int l = 0; l < i; ++l) v -= s[r][l] * s[i][l];
                s[r][i] = v * inverse;
            }
        }
        if (k + 1 == n) break;
        double *next = states + (size_t)(k + 1) * N * m;
        memcpy(work, x, sizeof(double) * N * m);
        for (int i = 0; i < NY; ++i)
            for (int l = 0; l < N; ++l) {
                const double v = gain[i * N + l];
                if (v == 0.0) continue;
                for (int j = 0; j < m; ++j) work[(size_t)l * m + j] += v * e[(size_t)i * m + j];
                for (int j = 0; j < N; ++j) p[l][j] -= v * gain[i * N + j];
            }
        system_matrix(f, a + (size_t)k * NX * NX, g + (size_t)k * NX * NF);
        memset(fp, 0, sizeof fp);
        memset(next, 0, sizeof(double) * N * m);
        for (int i = 0; i < N; ++i)
            for (int l = 0; l < N; ++l) {
                const double v = f[i][l];
                if (v == 0.0) continue;
                for (int j = 0; j < N; ++j) fp[i][j] += v * p[l][j];
                for (int j = 0; j < m; ++j) next[(size_t)i * m + j] += v * work[(size_t)l * m + j];
            }
        for (int i = 0; i < N; ++i)
            for (int j = 0; j <= i; ++j) {
                double v = 0.0;
                for (int l = 0; l < N; ++l) v += fp[i][l] * f[j][l];
                p[i][j] = p[j][i] = v;
            }
        for (int i = 0; i < NF; ++i)
            p[NX + i][NX + i] += force_var[i] * (1.0 - force_memory[i] * force_memory[i]);
        for (int i = 0; i < NC_; ++i)
            p[NX + NF + i][NX + NF + i] +=
                colour_var[i] * (1.0 - colour_memory[i] * colour_memory[i]);
    }
    /* Backward: adjoint (N x m) of the columns, information (N x N) of the future. */
    double *adjoint = work;
    double information[N][N], closed[N][N], product[N][N];
    memset(adjoint, 0, sizeof(double) * N * m);
    memset(information, 0, sizeof information);
    for (int k = n - 1; k >= 0; --k) {
        const double *gain = kept + (size_t)k * KEPT, *rows = gain + NY * N;
        const double *cov = rows + NY * N, *e = columns + (size_t)k * NY * m;
        double *x = states + (size_t)k * N * m;
        if (k + 1 < n) {
            /* closed = F (I - gain' rows); adjoint <- closed' adjoint. */
            system_matrix(f, a + (size_t)k * NX * NX, g + (size_t)k * NX * NF);
            memset(product, 0, sizeof product);
            for (int i = 0; i < N; ++i) product[i][i] = 1.0;
            for (int r = 0; r < NY; ++r)
                for (int i = 0; i < N; ++i)
                    for (int j = 0; j < N; ++j) product[i][j] -= gain[r * N + i] * rows[r * N + j];
            memset(closed, 0, sizeof closed);
            for (int i = 0; i < N; ++i)
                for (int l = 0; l < N; ++l)
                    if (f[i][l] != 0.0)
                        for (int j = 0; j < N; ++j) closed[i][j] += f[i][l] * product[l][j];
            for (int j = 0; j < m; ++j) {
                double column[N];
                for (int i = 0; i < N; ++i) column[i] = adjoint[(size_t)i * m + j];
                for (int i = 0; i < N; ++i) {
                    double v = 0.0;
                    for (int l = 0; l < N; ++l) v += closed[l][i] * column[l];
                    adjoint[(size_t)i * m + j] = v;
                }
            }
            memset(product, 0, sizeof product);
            for (int i = 0; i < N; ++i)
                for (int l = 0; l < N; ++l)
                    for (int j = 0; j < N; ++j) product[i][j] += information[i][l] * closed[l][j];
            memset(information, 0, sizeof information);
            for (int l = 0; l < N; ++l)
                for (int i = 0; i < N; ++i)
                    for (int j = 0; j < N; ++j) information[i][j] += closed[l][i] * product[l][j];
        }
        for (int r = 0; r < NY; ++r)
            for (int i = 0; i < N; ++i) {
                const double v = rows[r * N + i];
                if (v == 0.0) continue;
                for (int j = 0; j < m; ++j) adjoint[(size_t)i * m + j] += v * e[(size_t)r * m + j];
                for (int j = 0; j < N; ++j) information[i][j] += v * rows[r * N + j];
            }
        for (int i = 0; i < N; ++i)
            for (int l = 0; l < N; ++l) {
                const double v = cov[i * N + l];
                if (v != 0.0)
                    for (int j = 0; j < m; ++j) x[(size_t)i * m + j] += v * adjoint[(size_t)l * m + j];
            }
        for (int i = 0; i < NF; ++i) {
            const double *row = cov + (size_t)(NX + i) * N;
            double v = row[NX + i];
            for (int l = 0; l < N; ++l)
                for (int j = 0; j < N; ++j) v -= row[l] * information[l][j] * row[j];
            variance[(size_t)k * NF + i] = v;
        }
    }
    return 0;
}
