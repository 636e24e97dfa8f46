/* Innovations of an extended Kalman filter for a vehicle under first-order random forces.
 *
 * One call filters one record for LANES parameter vectors at once (finite
 * differences of whole filters). State of the filter: vehicle, forces, and the
 * coloured noise of one sensor:
 *
 *   x' = f(x, u, p) + G w,   w' = -w / tau + white,   y = x (+ c) + v
 *
 * Mean and tangent by Runge-Kutta along the filtered trajectory, one step per
 * sample; outputs enter one at a time. Compiled with -DREMUS or -DYAW.
 */
#include <math.h>

#define LANES 8
typedef double lane __attribute__((vector_size(8 * LANES)));
typedef double loose __attribute__((vector_size(8 * LANES), aligned(8))); /* of the caller */

static inline lane all(double a) { return (lane){a, a, a, a, a, a, a, a}; }
#define BY_LANE(name, function)                                                                    \
    static inline lane name(lane a) {                                                              \
        lane b;                                                                                    \
        for (int i = 0; i < LANES; i++) b[i] = function(a[i]);                                     \
        return b;                                                                                  \
    }
BY_LANE(sine, sin)
BY_LANE(cosine, cos)
BY_LANE(exponential, exp)
BY_LANE(absolute, fabs)

#ifdef REMUS
enum { NX = 5, NF = 3, NU = 2, NP = 8 };
enum { X_uu, Z_uw, Z_uq, M_uw, M_uq, Z_uuds, M_uuds, zgW };
static const double m = 30.48, surge = 31.41, heave = 65.98, pitch = 8.33;
static const double Z_qdot = -1.93, M_wdot = -1.93;

/* Rates, their derivatives by the state (row major) and by the noisy input. */
static inline void dynamics(const lane *x, const double *input, lane noise_free_input,
                            const lane *p, lane *f, lane *A, lane *b)
{
    const double det = heave * pitch - Z_qdot * M_wdot;
    const lane u = x[0], w = x[1], q = x[2], d = noise_free_input;
    const lane sn = sine(x[3]), cs = cosine(x[3]);
    const lane lift = p[Z_uw] * w + p[Z_uq] * q, moment = p[M_uw] * w + p[M_uq] * q;
    const lane Z = m * u * q + u * lift + p[Z_uuds] * u * u * d;
    const lane M = u * moment + p[M_uuds] * u * u * d - p[zgW] * sn;
    const lane Zx[3] = {m * q + lift + 2.0 * p[Z_uuds] * u * d, u * p[Z_uw], (m + p[Z_uq]) * u};
    const lane Mx[3] = {moment + 2.0 * p[M_uuds] * u * d, u * p[M_uw], u * p[M_uq]};
    const lane Mtheta = -p[zgW] * cs, Zd = p[Z_uuds] * u * u, Md = p[M_uuds] * u * u;
    f[0] = (-m * q * w + p[X_uu] * u * absolute(u) + input[1]) / surge;
    f[1] = (pitch * Z + Z_qdot * M) / det;
    f[2] = (heave * M + M_wdot * Z) / det;
    f[3] = q;
    f[4] = -u * sn + w * cs;
    for (int i = 0; i < NX * NX; i++) A[i] = all(0.0);
    A[0] = 2.0 * p[X_uu] * absolute(u) / surge;
    A[1] = -m * q / surge;
    A[2] = -m * w / surge;
    for (int j = 0; j < 3; j++) {
        A[5 + j] = (pitch * Zx[j] + Z_qdot * Mx[j]) / det;
        A[10 + j] = (heave * Mx[j] + M_wdot * Zx[j]) / det;
    }
    A[8] = Z_qdot * Mtheta / det;
    A[13] = heave * Mtheta / det;
    A[17] = all(1.0);
    A[20] = -sn;
    A[21] = cs;
    A[23] = -u * cs - w * sn;
    b[0] = b[3] = b[4] = all(0.0);
    b[1] = (pitch * Zd + Z_qdot * Md) / det;
    b[2] = (heave * Md + M_wdot * Zd) / det;
}

static inline double gain(int i, int j)
{
    const double det = heave * pitch - Z_qdot * M_wdot;
    if (i == 0 && j == 0) return 1.0 / surge;
    if (i == 1 && j > 0) return (j == 1 ? pitch : Z_qdot) / det;
    if (i == 2 && j > 0) return (j == 1 ? M_wdot : heave) / det;
    return 0.0;
}
#endif

#ifdef YAW
enum { NX = 2, NF = 1, NU = 1, NP = 4 };
enum { N_r, N_absrr, N_delta, zero };

static inline void dynamics(const lane *x, const double *input, lane noise_free_input,
                            const lane *p, lane *f, lane *A, lane *b)
{
    const lane r = x[1];
    (void)input;
    f[0] = r;
    f[1] = p[N_r] * r + p[N_absrr] * absolute(r) * r + p[N_delta] * (noise_free_input + p[zero]);
    A[0] = A[2] = all(0.0);
    A[1] = all(1.0);
    A[3] = p[N_r] + 2.0 * p[N_absrr] * absolute(r);
    b[0] = all(0.0);
    b[1] = p[N_delta];
}

static inline double gain(int i, int j) { return i == 1 && j == 0 ? 1.0 : 0.0; }
#endif

enum { NW = NX + NF, NA = NW + 1, NC = NW + 1 };

/* values: NP parameters, NX start states, NF force levels, force time, NX white levels,
 * coloured level, its time, level of the noise of input 0; each a vector of lanes.
 * innovations, variances: (n, NX) vectors; 0 and 1 where nothing was measured. */
int filter_record(int n, double h, int coloured, const double *outputs,
                  const unsigned char *present, const double *inputs, const loose *given,
                  loose *innovations, loose *variances)
{
    lane values[NP + NX + NF + 1 + NX + 3];
    for (int i = 0; i < NP + NX + NF + 1 + NX + 3; i++) values[i] = given[i];
    const lane *p = values, *start = values + NP, *level = start + NX;
    const lane tau = level[NF], *white = level + NF + 1;
    const lane colour = white[NX], colour_time = white[NX + 1], input_level = white[NX + 2];
    const lane phi = exponential(-h / tau), memory = exponential(-h / colour_time);
    const lane half = exponential(-0.5 * h / tau);
    lane x[NA], P[NA][NA];
    for (int i = 0; i < NA; i++) {
        x[i] = i < NX ? start[i] : all(0.0);
        for (int j = 0; j < NA; j++) P[i][j] = all(0.0);
    }
    for (int j = 0; j < NF; j++) P[NX + j][NX + j] = level[j] * level[j];
    if (coloured >= 0) P[NW][NW] = colour * colour;

    for (int k = 0; k < n; k++) {
        for (int o = 0; o < NX; o++) {
            loose *e = innovations + k * NX + o, *S = variances + k * NX + o;
            if (!present[k * NX + o]) {
                *e = all(0.0);
                *S = all(1.0);
                continue;
            }
            lane row[NA], K[NA];
            for (int j = 0; j < NA; j++) row[j] = o == coloured ? P[o][j] + P[NW][j] : P[o][j];
            *e = outputs[k * NX + o] - x[o] - (o == coloured ? x[NW] : all(0.0));
            *S = row[o] + (o == coloured ? row[NW] : all(0.0)) + white[o] * white[o];
            const lane inverse = 1.0 / *S;
            for (int j = 0; j < NA; j++) K[j] = row[j] * inverse;
            for (int j = 0; j < NA; j++) x[j] += K[j] * *e;
            for (int i = 0; i < NA; i++)
                for (int j = 0; j <= i; j++) P[i][j] = P[j][i] = P[i][j] - K[i] * row[j];
        }
        if (k + 1 == n) break;

        /* Runge-Kutta of the mean, and its derivatives by state, forces and noisy input. */
        static const double at[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
        const lane decay[4] = {all(1.0), half, half, phi};
        lane next[NX], tangent[NX][NC], rate[NX], slope[NX][NC];
        for (int i = 0; i < NX; i++) {
            next[i] = x[i];
            for (int c = 0; c < NC; c++) tangent[i][c] = all(c == i ? 1.0 : 0.0);
        }
        for (int s = 0; s < 4; s++) {
            lane here[NX], by[NX][NC], f[NX], A[NX * NX], b[NX];
            const double step = at[s] * h;
            for (int i = 0; i < NX; i++) {
                here[i] = s ? x[i] + step * rate[i] : x[i];
                for (int c = 0; c < NC; c++)
                    by[i][c] = s ? all(c == i ? 1.0 : 0.0) + step * slope[i][c]
                                 : all(c == i ? 1.0 : 0.0);
            }
            dynamics(here, inputs + k * NU, all(inputs[k * NU]), p, f, A, b);
            for (int i = 0; i < NX; i++) {
                rate[i] = f[i];
                for (int j = 0; j < NF; j++) rate[i] += gain(i, j) * decay[s] * x[NX + j];
                for (int c = 0; c < NC; c++) {
                    lane sum = all(0.0);
                    for (int l = 0; l < NX; l++) sum += A[i * NX + l] * by[l][c];
                    if (c >= NX && c < NW) sum += gain(i, c - NX) * decay[s];
                    if (c == NW) sum += b[i];
                    slope[i][c] = sum;
                }
                next[i] += weight[s] * h / 6.0 * rate[i];
                for (int c = 0; c < NC; c++)
                    tangent[i][c] += weight[s] * h / 6.0 * slope[i][c];
            }
        }
        for (int i = 0; i < NX; i++) x[i] = next[i];
        for (int j = 0; j < NF; j++) x[NX + j] *= phi;
        x[NW] *= memory;

        /* P <- F P F' + Q, with F = [tangent; phi; memory]. */
        lane FP[NX][NA];
        for (int i = 0; i < NX; i++)
            for (int j = 0; j < NA; j++) {
                lane sum = all(0.0);
                for (int l = 0; l < NW; l++) sum += tangent[i][l] * P[l][j];
                FP[i][j] = sum;
            }
        for (int i = 0; i < NX; i++) {
            for (int j = 0; j <= i; j++) {
                lane sum = input_level * input_level * tangent[i][NW] * tangent[j][NW];
                for (int l = 0; l < NW; l++) sum += FP[i][l] * tangent[j][l];
                for (int f = 0; f < NF; f++)
                    sum += gain(i, f) * gain(j, f) * (2.0 * h * h * h / 3.0) * level[f] * level[f] /
                           tau;
                P[i][j] = P[j][i] = sum;
            }
            for (int f = 0; f < NF; f++)
                P[i][NX + f] = P[NX + f][i] =
                    FP[i][NX + f] * phi + gain(i, f) * h * h * level[f] * level[f] / tau;
            P[i][NW] = P[NW][i] = FP[i][NW] * memory;
        }
        for (int f = 0; f < NF; f++) {
            for (int g = 0; g < NF; g++) P[NX + f][NX + g] *= phi * phi;
            P[NX + f][NX + f] += level[f] * level[f] * (1.0 - phi * phi);
            P[NX + f][NW] = P[NW][NX + f] = P[NX + f][NW] * phi * memory;
        }
        P[NW][NW] *= memory * memory;
        if (coloured >= 0) P[NW][NW] += colour * colour * (1.0 - memory * memory);
    }
    return 0;
}
