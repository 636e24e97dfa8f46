/* Innovations of one residual under several noise models at once.
 *
 * The same filter as innovations.c, run side by side: every number has LANES
 * values, one per noise model, and every innermost loop runs over the lanes, so
 * that derivatives by noise levels cost little more than one filter.
 * Sizes are macros: NX state deviations, NF coloured forces, NY outputs, of
 * which each also has a coloured sensor disturbance when COLOUR is 1.
 */

#include <math.h>
#include <string.h>

#define NC_ (COLOUR ? NY : 0)
#define N (NX + NF + NC_)
#define EACH for (int q = 0; q < LANES; ++q)

/* Returns 0, or 1 when an innovation covariance is not positive definite.
 *
 * n times; a (n x NX x NX), g (n x NX x NF), c (n x NY x NX), present (n x NY) and
 * residual (n x NY) are common; force_var (NF x LANES), colour_var (NY x LANES) and
 * white_var (NY x LANES) differ; force_memory (NF), colour_memory (NY).
 * white and roots (n x NY x LANES) receive innovations and their standard deviations,
 * 0 and 1 where not measured.
 */
int innovations_lanes(int n, const double *a, const double *g, const double *c,
                      const double *present, const double *residual, const double *force_var,
                      const double *force_memory, const double *colour_var,
                      const double *colour_memory, const double *white_var, double *white,
                      double *roots)
{
    double p[N][N][LANES], fp[NX][N][LANES], x[N][LANES], next[NX][LANES];
    double gain[NY][N][LANES], s[NY][NY][LANES];
    memset(p, 0, sizeof p);
    memset(x, 0, sizeof x);
    for (int i = 0; i < NF; ++i) EACH p[NX + i][NX + i][q] = force_var[i * LANES + q];
    for (int i = 0; i < NC_; ++i)
        EACH p[NX + NF + i][NX + NF + i][q] = colour_var[i * LANES + q];
    for (int k = 0; k < n; ++k) {
        const double *ck = c + (size_t)k * NY * NX, *seen = present + (size_t)k * NY;
        double *ek = white + (size_t)k * NY * LANES, *rk = roots + (size_t)k * NY * LANES;
        /* gain = H P, s = gain H', e = residual - H x. */
        for (int i = 0; i < NY; ++i) {
            double *e = ek + i * LANES;
            memset(gain[i], 0, sizeof gain[i]);
            EACH e[q] = 0.0;
            if (seen[i] == 0.0) continue;
            EACH e[q] = residual[(size_t)k * NY + i];
            for (int l = 0; l < NX; ++l) {
                const double v = ck[i * NX + l];
                if (v == 0.0) continue;
                EACH e[q] -= v * x[l][q];
                for (int j = 0; j < N; ++j) EACH gain[i][j][q] += v * p[l][j][q];
            }
            if (NC_) {
                EACH e[q] -= x[NX + NF + i][q];
                for (int j = 0; j < N; ++j) EACH gain[i][j][q] += p[NX + NF + i][j][q];
            }
        }
        memset(s, 0, sizeof s);
        for (int i = 0; i < NY; ++i) {
            if (seen[i] == 0.0) {
                EACH s[i][i][q] = 1.0;
                continue;
            }
            EACH s[i][i][q] = white_var[i * LANES + q];
            for (int j = 0; j <= i; ++j) {
                if (seen[j] == 0.0) continue;
                for (int l = 0; l < NX; ++l) {
                    const double v = ck[j * NX + l];
                    if (v != 0.0) EACH s[i][j][q] += v * gain[i][l][q];
                }
                if (NC_) EACH s[i][j][q] += gain[i][NX + NF + j][q];
            }
        }
        /* e <- L^-1 e, gain <- L^-1 gain, by Cholesky of s, row by row. */
        for (int i = 0; i < NY; ++i) {
            double *e = ek + i * LANES, inverse[LANES], pivot[LANES];
            int regular = 1;
            EACH pivot[q] = s[i][i][q];
            for (int l = 0; l < i; ++l) {
                if (seen[i] == 0.0 || seen[l] == 0.0) continue;
                EACH pivot[q] -= s[i][l][q] * s[i][l][q];
                EACH e[q] -= s[i][l][q] * ek[l * LANES + q];
                for (int j = 0; j < N; ++j) EACH gain[i][j][q] -= s[i][l][q] * gain[l][j][q];
            }
            EACH regular &= pivot[q] > 0.0;
            if (!regular) return 1;
            EACH {
                const double root = sqrt(pivot[q]);
                inverse[q] = 1.0 / root;
                rk[i * LANES + q] = root;
                e[q] *= inverse[q];
            }
            for (int j = 0; j < N; ++j) EACH gain[i][j][q] *= inverse[q];
            for (int r = i + 1; r < NY; ++r) {
                for (int l = 0; l < i; ++l) EACH s[r][i][q] -= s[r][l][q] * s[i][l][q];
                EACH s[r][i][q] *= inverse[q];
            }
        }
        if (k + 1 == n) break;
        /* Measurement update of the lower triangle, mirrored, then prediction. */
        for (int i = 0; i < NY; ++i) {
            if (seen[i] == 0.0) continue;
            for (int l = 0; l < N; ++l) {
                EACH x[l][q] += gain[i][l][q] * ek[i * LANES + q];
                for (int j = 0; j <= l; ++j) EACH p[l][j][q] -= gain[i][l][q] * gain[i][j][q];
            }
        }
        for (int l = 0; l < N; ++l)
            for (int j = 0; j < l; ++j) EACH p[j][l][q] = p[l][j][q];
        const double *ak = a + (size_t)k * NX * NX, *gk = g + (size_t)k * NX * NF;
        memset(fp, 0, sizeof fp);
        memset(next, 0, sizeof next);
        for (int i = 0; i < NX; ++i)
            for (int l = 0; l < NX + NF; ++l) {
                const double v = l < NX ? ak[i * NX + l] : gk[i * NF + l - NX];
                if (v == 0.0) continue;
                EACH next[i][q] += v * x[l][q];
                for (int j = 0; j < N; ++j) EACH fp[i][j][q] += v * p[l][j][q];
            }
        memcpy(x, next, sizeof next);
        for (int i = 0; i < NX; ++i)
            for (int j = 0; j <= i; ++j) {
                double v[LANES];
                memset(v, 0, sizeof v);
                for (int l = 0; l < NX; ++l) {
                    const double w = ak[j * NX + l];
                    if (w != 0.0) EACH v[q] += w * fp[i][l][q];
                }
                for (int l = 0; l < NF; ++l) {
                    const double w = gk[j * NF + l];
                    if (w != 0.0) EACH v[q] += w * fp[i][NX + l][q];
                }
                EACH p[i][j][q] = p[j][i][q] = v[q];
            }
        /* Disturbances only remember: their rows of the transition are diagonal. */
        for (int i = NX; i < N; ++i) {
            const int force = i < NX + NF, own = force ? i - NX : i - NX - NF;
            const double left = force ? force_memory[own] : colour_memory[own];
            const double *drive = (force ? force_var : colour_var) + own * LANES;
            EACH x[i][q] *= left;
            for (int j = 0; j < NX; ++j)
                EACH p[i][j][q] = p[j][i][q] = left * fp[j][i][q];
            for (int j = NX; j <= i; ++j) {
                const int other = j < NX + NF ? j - NX : j - NX - NF;
                const double too = j < NX + NF ? force_memory[other] : colour_memory[other];
                EACH p[i][j][q] = p[j][i][q] = left * too * p[i][j][q];
            }
            EACH p[i][i][q] += drive[q] * (1.0 - left * left);
        }
    }
    return 0;
}
