/* Trajectory and forward sensitivities of a sampled model.
 *
 * Included after the code that CasADi generated for one model structure and
 * after the macros that describe it (sizes, sparse Jacobian updates).
 *
 *   NX states  NA actuator memory  NS sensor memory  NZ = NX + NA + NS
 *   ND actuator signals  NU inputs  NY outputs  NP parameters  NF free ones
 *
 * Sensitivities are rows of the full state by NC = NZ + NF columns: first the
 * derivative by the segment's own start state, then by the free parameters.
 *
 * Compiled with SELECT, the caller chooses at run time which parameters have a
 * column, so that one library serves every sub-model of a large model.
 */

#include <math.h>
#include <string.h>

#define MAX1(n) ((n) > 0 ? (n) : 1)

/* With the filter many loops call the same stages: compiled once, they cost a call, and half the
 * time of compilation is saved. */
#ifdef FILTER
#define ONCE __attribute__((noinline))
#else
#define ONCE
#endif

/* Rows are padded with zeros to whole vectors. */
#define WIDTH ((NC + 3) / 4 * 4)
typedef double row_t[WIDTH] __attribute__((aligned(32)));

/* Scratch rows: on the stack where they are small, since thread-local memory of a
 * shared library costs a call at every use. */
#if NZ * NC <= 4096
#define SCRATCH
#else
#define SCRATCH static _Thread_local
#endif

/* Columns of sensitivities: how many, the same in whole vectors, and where each parameter's stands,
 * or none where that is negative. Chosen at run time, or all. */
typedef struct {
    int count, width;
    const int *of;
} columns_t;

#ifdef SELECT
#define ACTIVE (columns->width)
#define COLUMNS (columns->count)
#define PARAMETER(row, index, value) \
    if (columns->of[index] >= 0) row[columns->of[index]] += value;
#else
#define ACTIVE WIDTH
#define COLUMNS NC
#define PARAMETER(row, index, value) row[NZ + index] += value;
#endif

/* Four numbers at a time: the columns in use are whole vectors. */
typedef double four_t __attribute__((vector_size(32), aligned(8)));

/* Products of sparse Jacobians and rows, whose statements are generated: all rows of a target, four
 * columns at a time, from column j. */
#define FOUR(rows, i) (*(four_t *)((rows)[i] + j))
#define PRODUCTS(statements) \
    for (int j = 0, width = ACTIVE; j < width; j += 4) { statements }

/* Loops over the vectors of a block: their sums stay in registers. */
#define UNROLLED _Pragma("GCC unroll 8")

/* Lower triangle of gram, in blocks of four by four, plus the products of n rows; all have a stride
 * of wide, in which width is padded with zeros. */
static inline void add_products(double *restrict gram, const double *restrict rows, int n, int wide,
                                int width)
{
    for (int a = 0; a < width; a += 4)
        for (int b = 0; b <= a; b += 4) {
            double *to = gram + (size_t)a * wide + b;
            four_t sum[4];
            UNROLLED
            for (int i = 0; i < 4; ++i) sum[i] = *(four_t *)(to + (size_t)i * wide);
            for (int o = 0; o < n; ++o) {
                const double *row = rows + (size_t)o * wide;
                const four_t right = *(const four_t *)(row + b);
                UNROLLED
                for (int i = 0; i < 4; ++i) sum[i] += row[a + i] * right;
            }
            UNROLLED
            for (int i = 0; i < 4; ++i) *(four_t *)(to + (size_t)i * wide) = sum[i];
        }
}

/* Zeros in the columns in use. */
static inline void clear_rows(row_t *rows, int n, const columns_t *columns)
{
    const int width = ACTIVE;
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < width; j += 4) *(four_t *)(rows[i] + j) = (four_t){0.0, 0.0, 0.0, 0.0};
}

/* target <- base + factor rate, in the columns in use. */
static inline void step_rows(row_t *restrict target, const row_t *base, double factor,
                             const row_t *rate, int n, const columns_t *columns)
{
    const int width = ACTIVE;
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < width; j += 4)
            *(four_t *)(target[i] + j) =
                *(const four_t *)(base[i] + j) + factor * *(const four_t *)(rate[i] + j);
}

/* target <- source, in the columns in use. */
static inline void take_rows(row_t *restrict target, const row_t *source, int n,
                             const columns_t *columns)
{
    const int width = ACTIVE;
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < width; j += 4)
            *(four_t *)(target[i] + j) = *(const four_t *)(source[i] + j);
}

/* Rows without their padding. */
static inline void copy_rows(double *target, const row_t *rows, int n, const columns_t *columns)
{
    const int count = COLUMNS;
    for (int i = 0; i < n; ++i) memcpy(target + (size_t)i * count, rows[i], sizeof(double) * count);
}

static void inputs_between(const double *start, const double *end, double fraction, double *result)
{
    static const int linear[MAX1(NU)] = LINEAR_INPUTS;
    for (int i = 0; i < NU; ++i)
        result[i] = linear[i] ? start[i] + fraction * (end[i] - start[i]) : start[i];
}

/* Actuator stage: signals d and next memory, with their rows of sensitivities; memory_next and
 * sa_next may be NULL. */
static void actuate_stage(const double *memory, const double *input, const double *p, double t,
                          double h, double *d, double *memory_next, const row_t *s,
                          row_t *sd, row_t *sa_next, const columns_t *columns)
{
    double w[MAX1(W_ACTUATE)];
    casadi_int iw[MAX1(IW_ACTUATE)];
    const double *arg[8] = {memory, input, p, &t, &h};
    if (!columns) {
        double *res[4] = {d, memory_next};
        actuate(arg, res, iw, w, 0);
        return;
    }
    double dda[MAX1(NNZ_DDA)], ddp[MAX1(NNZ_DDP)], daa[MAX1(NNZ_DAA)], dap[MAX1(NNZ_DAP)];
    double *res[8] = {d, memory_next, dda, ddp, daa, dap};
    actuate_jac(arg, res, iw, w, 0);
    const row_t *sa = s + NX;
    PRODUCTS(ROWS_SD)
    PARAMETERS_SD
    if (!sa_next) return;
    PRODUCTS(ROWS_SA_NEXT)
    PARAMETERS_SA_NEXT
}

/* Rates and the rows k = A s + B sd + C. */
static void rates_stage(const double *x, const double *d, const double *p, double t, double *k,
                        const row_t *s, const row_t *sd, row_t *sk, const columns_t *columns)
{
    double w[MAX1(W_RATES)];
    casadi_int iw[MAX1(IW_RATES)];
    const double *arg[8] = {x, d, p, &t};
    if (!columns) {
        double *res[2] = {k};
        rates(arg, res, iw, w, 0);
        return;
    }
    double jxx[MAX1(NNZ_JXX)], jxd[MAX1(NNZ_JXD)], jxp[MAX1(NNZ_JXP)];
    double *res[8] = {k, jxx, jxd, jxp};
    rates_jac(arg, res, iw, w, 0);
    PRODUCTS(ROWS_SK)
    PARAMETERS_SK
}

#ifdef IMPLICIT

/* Factors of I - hg A with partial pivots, in place; 0 where it is singular. */
static int factorize(double m[MAX1(NX)][MAX1(NX)], int *pivot)
{
    for (int c = 0; c < NX; ++c) {
        int best = c;
        for (int i = c + 1; i < NX; ++i)
            if (fabs(m[i][c]) > fabs(m[best][c])) best = i;
        pivot[c] = best;
        if (!(fabs(m[best][c]) > 0.0)) return 0;
        if (best != c)
            for (int j = 0; j < NX; ++j) {
                const double v = m[c][j];
                m[c][j] = m[best][j];
                m[best][j] = v;
            }
        for (int i = c + 1; i < NX; ++i) {
            m[i][c] /= m[c][c];
            for (int j = c + 1; j < NX; ++j) m[i][j] -= m[i][c] * m[c][j];
        }
    }
    return 1;
}

/* Solve with these factors, n right-hand sides in the rows of b with a stride. */
static void solve_factors(const double m[MAX1(NX)][MAX1(NX)], const int *pivot, double *b, int n,
                          int stride)
{
    for (int c = 0; c < NX; ++c)
        if (pivot[c] != c)
            for (int j = 0; j < n; ++j) {
                const double v = b[(size_t)c * stride + j];
                b[(size_t)c * stride + j] = b[(size_t)pivot[c] * stride + j];
                b[(size_t)pivot[c] * stride + j] = v;
            }
    for (int i = 1; i < NX; ++i)
        for (int l = 0; l < i; ++l)
            for (int j = 0; j < n; ++j) b[(size_t)i * stride + j] -= m[i][l] * b[(size_t)l * stride + j];
    for (int i = NX - 1; i >= 0; --i) {
        for (int l = i + 1; l < NX; ++l)
            for (int j = 0; j < n; ++j) b[(size_t)i * stride + j] -= m[i][l] * b[(size_t)l * stride + j];
        for (int j = 0; j < n; ++j) b[(size_t)i * stride + j] /= m[i][i];
    }
}

/* One stage: x, which comes with a first guess, solves x = base + hg f(x); sx its rows from
 * those of base. Newton's method with the exact Jacobian; NaN where it does not arrive. */
static void implicit_stage(double *x, const double *base, const double *d, const double *p,
                           double t, double hg, row_t *sx, const row_t *sbase, const row_t *sd,
                           const columns_t *columns)
{
    double w[MAX1(W_RATES)], k[MAX1(NX)], step[MAX1(NX)], matrix[MAX1(NX)][MAX1(NX)];
    double jxx[MAX1(NNZ_JXX)], jxd[MAX1(NNZ_JXD)], jxp[MAX1(NNZ_JXP)];
    casadi_int iw[MAX1(IW_RATES)];
    int pivot[MAX1(NX)], arrived = 0;
    for (int round = 0; round < NEWTON_MOST; ++round) {
        const double *arg[8] = {x, d, p, &t};
        double *res[8] = {k, jxx, jxd, jxp};
        rates_jac(arg, res, iw, w, 0);
        memset(matrix, 0, sizeof matrix);
        { const double *v = jxx; FILL_JXX (void)v; }
        for (int i = 0; i < NX; ++i) {
            for (int j = 0; j < NX; ++j) matrix[i][j] *= -hg;
            matrix[i][i] += 1.0;
            step[i] = base[i] + hg * k[i] - x[i];
        }
        if (!factorize(matrix, pivot)) break;
        /* The rows of an exact solution need its own Jacobian, hence one round more. */
        if (arrived) {
            if (!columns) return;
            row_t *sk = sx; /* without A, which is in the matrix */
            PRODUCTS(ROWS_SK_BESIDE)
            PARAMETERS_SK
            for (int i = 0; i < NX; ++i)
                for (int j = 0; j < ACTIVE; ++j) sx[i][j] = sbase[i][j] + hg * sx[i][j];
            solve_factors(matrix, pivot, sx[0], ACTIVE, WIDTH);
            return;
        }
        solve_factors(matrix, pivot, step, 1, 1);
        arrived = 1;
        for (int i = 0; i < NX; ++i) {
            const double size = fmax(fmax(fabs(x[i]), fabs(base[i])), fabs(hg * k[i]));
            x[i] += step[i];
            if (!(fabs(step[i]) <= NEWTON_STEP * size + NEWTON_FLOOR)) arrived = 0;
        }
        if (arrived && !columns) return;
    }
    for (int i = 0; i < NX; ++i) x[i] = NAN;
}

/* One integration step of length h by three diagonally implicit stages; z and s are replaced. */
static void advance_step(double *z, row_t *s, const double *start, const double *end,
                         const double *p, double t, double h, const columns_t *columns)
{
    static const double weights[3][3] = STAGE_WEIGHTS, fractions[3] = STAGE_FRACTIONS;
    double input[MAX1(NU)], d[MAX1(ND)], memory[MAX1(NA)];
    double x[MAX1(NX)], base[MAX1(NX)], k[2][MAX1(NX)];
    SCRATCH row_t sd[MAX1(ND)], sa[MAX1(NA)], sbase[MAX1(NX)], sx[MAX1(NX)], sk[2][MAX1(NX)];
    const double hg = h * fractions[0];
    inputs_between(start, end, 0.5, input);
    actuate_stage(z + NX, input, p, t, h, d, memory, (const row_t *)s, sd, sa, columns);
    memcpy(x, z, sizeof(double) * NX);
    for (int stage = 0; stage < 3; ++stage) {
        if (ANY_LINEAR_INPUT) {
            inputs_between(start, end, fractions[stage], input);
            actuate_stage(z + NX, input, p, t, h, d, NULL, (const row_t *)s, sd, NULL,
                          columns);
        }
        for (int i = 0; i < NX; ++i) {
            base[i] = z[i];
            for (int l = 0; l < stage; ++l) base[i] += h * weights[stage][l] * k[l][i];
        }
        if (columns)
            for (int i = 0; i < NX; ++i) {
                for (int j = 0; j < ACTIVE; ++j) sbase[i][j] = s[i][j];
                for (int l = 0; l < stage; ++l)
                    for (int j = 0; j < ACTIVE; ++j)
                        sbase[i][j] += h * weights[stage][l] * sk[l][i][j];
            }
        implicit_stage(x, base, d, p, t + fractions[stage] * h, hg, sx, (const row_t *)sbase,
                       (const row_t *)sd, columns);
        if (stage == 2) break;
        for (int i = 0; i < NX; ++i) k[stage][i] = (x[i] - base[i]) / hg;
        if (columns)
            for (int i = 0; i < NX; ++i)
                for (int j = 0; j < ACTIVE; ++j) sk[stage][i][j] = (sx[i][j] - sbase[i][j]) / hg;
    }
    memcpy(z, x, sizeof(double) * NX);
    for (int i = 0; i < NA; ++i) z[NX + i] = memory[i];
    if (columns) {
        for (int i = 0; i < NX; ++i)
            for (int j = 0; j < ACTIVE; ++j) s[i][j] = sx[i][j];
        take_rows(s + NX, (const row_t *)sa, NA, columns);
    }
}

#else

/* One integration step of length h; z and s are replaced. */
static ONCE void advance_step(double *z, row_t *s, const double *start, const double *end,
                         const double *p, double t, double h, const columns_t *columns)
{
    double input[MAX1(NU)], d0[MAX1(ND)], dm[MAX1(ND)], d1[MAX1(ND)], memory[MAX1(NA)];
    SCRATCH row_t sd0[MAX1(ND)], sdm[MAX1(ND)], sd1[MAX1(ND)], sa[MAX1(NA)], k1s[MAX1(NX)],
        k2s[MAX1(NX)], k3s[MAX1(NX)], k4s[MAX1(NX)], stage[MAX1(NX)];
    double x[MAX1(NX)], k1[MAX1(NX)], k2[MAX1(NX)], k3[MAX1(NX)], k4[MAX1(NX)];
    const double *first = d0, *middle = d0, *last = d0;
    const row_t *sfirst = sd0, *smiddle = sd0, *slast = sd0;
    inputs_between(start, end, 0.0, input);
    /* Memory moves on with the inputs of the middle. */
    actuate_stage(z + NX, input, p, t, h, d0, ANY_LINEAR_INPUT ? NULL : memory, (const row_t *)s,
                  sd0, ANY_LINEAR_INPUT ? NULL : sa, columns);
    if (ANY_LINEAR_INPUT) {
        inputs_between(start, end, 0.5, input);
        actuate_stage(z + NX, input, p, t, h, dm, memory, (const row_t *)s, sdm, sa,
                      columns);
        inputs_between(start, end, 1.0, input);
        actuate_stage(z + NX, input, p, t, h, d1, NULL, (const row_t *)s, sd1, NULL,
                      columns);
        middle = dm; last = d1;
        smiddle = (const row_t *)sdm; slast = (const row_t *)sd1;
    }
    rates_stage(z, first, p, t, k1, (const row_t *)s, sfirst, k1s, columns);
    for (int i = 0; i < NX; ++i) x[i] = z[i] + 0.5 * h * k1[i];
    if (columns) step_rows(stage, (const row_t *)s, 0.5 * h, (const row_t *)k1s, NX, columns);
    rates_stage(x, middle, p, t + 0.5 * h, k2, (const row_t *)stage, smiddle, k2s,
                columns);
    for (int i = 0; i < NX; ++i) x[i] = z[i] + 0.5 * h * k2[i];
    if (columns) step_rows(stage, (const row_t *)s, 0.5 * h, (const row_t *)k2s, NX, columns);
    rates_stage(x, middle, p, t + 0.5 * h, k3, (const row_t *)stage, smiddle, k3s,
                columns);
    for (int i = 0; i < NX; ++i) x[i] = z[i] + h * k3[i];
    if (columns) step_rows(stage, (const row_t *)s, h, (const row_t *)k3s, NX, columns);
    rates_stage(x, last, p, t + h, k4, (const row_t *)stage, slast, k4s, columns);
    for (int i = 0; i < NX; ++i) z[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    for (int i = 0; i < NA; ++i) z[NX + i] = memory[i];
    if (columns) {
        const int width = ACTIVE;
        for (int i = 0; i < NX; ++i)
            for (int j = 0; j < width; j += 4)
                *(four_t *)(s[i] + j) +=
                    h / 6.0 *
                    (*(four_t *)(k1s[i] + j) +
                     2.0 * (*(four_t *)(k2s[i] + j) + *(four_t *)(k3s[i] + j)) +
                     *(four_t *)(k4s[i] + j));
        take_rows(s + NX, (const row_t *)sa, NA, columns);
    }
}

#endif

/* One measurement, h after the last moment that sensor memory, which is replaced in z and s, took
 * in. */
static ONCE void sample_step(double *z, row_t *s, const double *input, const double *p, double t,
                        double h, double *y, row_t *sy, const columns_t *columns)
{
    double d[MAX1(ND)], next[MAX1(NS)];
    double w[MAX1(W_OBSERVE)];
    casadi_int iw[MAX1(IW_OBSERVE)];
    SCRATCH row_t sd[MAX1(ND)], snext[MAX1(NS)];
    /* Signals of actuators only where a sensor sees them. */
    if (NNZ_JYD + NNZ_JSD > 0)
        actuate_stage(z + NX, input, p, t, h, d, NULL, (const row_t *)s, sd, NULL, columns);
    const double *arg[8] = {z, d, z + NX + NA, p, &t, &h};
    if (!columns) {
        double *res[4] = {y, next};
        observe(arg, res, iw, w, 0);
    } else {
        double jyx[MAX1(NNZ_JYX)], jyd[MAX1(NNZ_JYD)], jys[MAX1(NNZ_JYS)], jyp[MAX1(NNZ_JYP)];
        double jsx[MAX1(NNZ_JSX)], jsd[MAX1(NNZ_JSD)], jss[MAX1(NNZ_JSS)], jsp[MAX1(NNZ_JSP)];
        double *res[12] = {y, next, jyx, jyd, jys, jyp, jsx, jsd, jss, jsp};
        observe_jac(arg, res, iw, w, 0);
        const row_t *ss = (const row_t *)(s + NX + NA);
        PRODUCTS(ROWS_SY)
        PARAMETERS_SY
        PRODUCTS(ROWS_SNEXT)
        PARAMETERS_SNEXT
        take_rows(s + NX + NA, (const row_t *)snext, NS, columns);
    }
    for (int i = 0; i < NS; ++i) z[NX + NA + i] = next[i];
}

/* Equal steps of an interval, none longer than h_max. */
static inline int steps_within(double interval, double h_max)
{
    const int steps = (int)ceil(interval / h_max - 1e-9);
    return steps < 1 ? 1 : steps;
}

/* The interval that ends at sample k; the first one where there is none. */
static inline double interval_before(const double *times, int n, int k)
{
    return k > 0 ? times[k] - times[k - 1] : (n > 1 ? times[1] - times[0] : 1.0);
}

/* From sample k to sample k + 1, in steps no longer than h_max. Memory of sensors that has taken in
 * the first of these moments takes in the others too where it is asked for. */
static void advance_interval(double *z, row_t *s, const double *times, const double *input,
                             const double *p, double h_max, int k, int remember,
                             const columns_t *columns)
{
    const double interval = times[k + 1] - times[k];
    const double *next = input + NU;
    const int steps = steps_within(interval, h_max);
    const double h = interval / steps;
    double from[MAX1(NU)], to[MAX1(NU)], y[MAX1(NY)];
    SCRATCH row_t sy[MAX1(NY)];
    for (int i = 0; i < steps; ++i) {
        if (ANY_LINEAR_INPUT) {
            inputs_between(input, next, (double)i / steps, from);
            inputs_between(input, next, (double)(i + 1) / steps, to);
        }
        if (remember && i > 0)
            sample_step(z, s, ANY_LINEAR_INPUT ? from : input, p, times[k] + i * h, h, y, sy,
                        columns);
        advance_step(z, s, ANY_LINEAR_INPUT ? from : input, ANY_LINEAR_INPUT ? to : next, p,
                     times[k] + i * h, h, columns);
    }
}

/* Sizes, so that the caller can check that it talks to the right library. */
void kernel_sizes(int *sizes)
{
    sizes[0] = NX; sizes[1] = NA; sizes[2] = NS; sizes[3] = NU;
    sizes[4] = NY; sizes[5] = NP; sizes[6] = NF; sizes[7] = N_OWN;
}

/* Full state implied by the model's own states; dz is NZ x (N_OWN + NF). */
void kernel_start(const double *own, const double *input, const double *p, double t, double *z,
                  double *dz)
{
    static const int places[] = START_PLACES;
    double w[MAX1(W_START)], v[MAX1(NNZ_START)];
    casadi_int iw[MAX1(IW_START)];
    const double *arg[8] = {own, input, p, &t};
    double *res[4] = {z, v};
    start_jac(arg, res, iw, w, 0);
    memset(dz, 0, sizeof(double) * NZ * (N_OWN + NF));
    for (int i = 0; i < NNZ_START; ++i) dz[places[i]] = v[i];
}

#ifdef SELECT
/* Columns of the runs of this thread: those of all start states, then of each parameter the one
 * that is stated, or none where that is negative. */
static _Thread_local columns_t selected;

void kernel_select(int width, const int *columns)
{
    selected = (columns_t){width, (width + 3) & ~3, columns};
}
#else
static const columns_t selected = {NC, WIDTH, NULL};
#endif

/* Run segments of one record.
 *
 * times (n), inputs (n x NU), p (NP), starts (n_segments: index of the first
 * sample of each), nodes (n_segments x NZ; each segment but the first takes only
 * the first from_nodes states of its own, and goes on from where the last one ended
 * with the others).
 * Any result may be NULL: z (n x NZ, before the measurement), y (n x NY),
 * dy (n x NY x columns), ends (n_segments x NZ), dends (n_segments x NZ x columns), all NC columns
 * or those of kernel_select.
 * Returns -1, or the first sample at which the state is no longer finite.
 */
int kernel_run(int n, const double *times, const double *inputs, const double *p, double h_max,
               int n_segments, const int *starts, const double *nodes, int from_nodes,
               double *z_out, double *y_out, double *dy_out, double *ends, double *dends)
{
    const columns_t *columns = dy_out || dends ? &selected : NULL;
    double z[MAX1(NZ)], y[MAX1(NY)];
    SCRATCH row_t s[MAX1(NZ)], sy[MAX1(NY)];
    memcpy(z, nodes, sizeof(double) * NZ);
    for (int segment = 0; segment < n_segments; ++segment) {
        const int first = starts[segment];
        const int stop = segment + 1 < n_segments ? starts[segment + 1] : n;
        if (segment && from_nodes)
            memcpy(z, nodes + (size_t)segment * NZ, sizeof(double) * from_nodes);
        if (columns) {
            clear_rows(s, NZ, columns);
            for (int i = 0; i < NZ; ++i) s[i][i] = 1.0;
        }
        for (int k = first; k < stop; ++k) {
            const double *input = inputs + (size_t)k * NU;
            const double before = interval_before(times, n, k);
            const double since = before / steps_within(before, h_max);
            double check = 0.0;
            for (int i = 0; i < NZ; ++i) check += z[i];
            if (!(fabs(check) < DIVERGED)) return k;
            if (z_out) memcpy(z_out + (size_t)k * NZ, z, sizeof(double) * NZ);
            if (y_out || dy_out || NS > 0) {
                sample_step(z, s, input, p, times[k], since, y, sy, columns);
                if (y_out) memcpy(y_out + (size_t)k * NY, y, sizeof(double) * NY);
                if (dy_out) copy_rows(dy_out + (size_t)k * NY * COLUMNS, (const row_t *)sy, NY, columns);
            }
            if (k + 1 >= n) break;
            advance_interval(z, s, times, input, p, h_max, k, NS > 0, columns);
        }
        if (ends) memcpy(ends + (size_t)segment * NZ, z, sizeof(double) * NZ);
        if (dends) copy_rows(dends + (size_t)segment * NZ * COLUMNS, (const row_t *)s, NZ, columns);
    }
    return -1;
}

#ifndef SELECT
/* Columns of a row that carries its residual too, and the same rounded up to whole vectors. */
#define NG (NC + 1)
#define NV ((NG + 3) / 4 * 4)

typedef double gram_t[NV][NV] __attribute__((aligned(32)));

/* Add the products of one measurement's rows, scaled, to a segment's normal equations. */
static void gather_sample(gram_t sum, const row_t *sy, const double *y, const double *measured,
                          const double *weight)
{
    double rows[MAX1(NY)][NV] __attribute__((aligned(32)));
    for (int i = 0; i < NY; ++i) {
        const double residual = measured[i] - y[i];
        const double factor = isnan(measured[i]) ? 0.0 : weight[i];
        for (int j = 0; j < NC; ++j) rows[i][j] = factor * sy[i][j];
        rows[i][NC] = factor != 0.0 ? factor * residual : 0.0;
        for (int j = NG; j < NV; ++j) rows[i][j] = 0.0;
    }
    add_products(sum[0], rows[0], NY, NV, NG);
}

/* Run segments of one record and gather the normal equations of each.
 *
 * Arguments as of kernel_run with whole nodes; measured (n x NY), NaN where
 * missing; weight (NY), inverse standard deviations. Results: gram (n_segments
 * x NG x NG), the sum of [dy r]' [dy r] over the segment's samples, all scaled,
 * r = measured - y; ends, dends as of kernel_run. Returns as kernel_run does.
 */
int kernel_gather(int n, const double *times, const double *inputs, const double *p, double h_max,
                  int n_segments, const int *starts, const double *nodes, const double *measured,
                  const double *weight, double *gram, double *ends, double *dends)
{
    const columns_t *columns = &selected;
    double z[MAX1(NZ)], y[MAX1(NY)];
    SCRATCH row_t s[MAX1(NZ)], sy[MAX1(NY)];
    SCRATCH gram_t sum;
    for (int segment = 0; segment < n_segments; ++segment) {
        const int first = starts[segment];
        const int stop = segment + 1 < n_segments ? starts[segment + 1] : n;
        memcpy(z, nodes + (size_t)segment * NZ, sizeof(double) * NZ);
        clear_rows(s, NZ, columns);
        for (int i = 0; i < NZ; ++i) s[i][i] = 1.0;
        memset(sum, 0, sizeof sum);
        for (int k = first; k < stop; ++k) {
            const double *input = inputs + (size_t)k * NU;
            const double before = interval_before(times, n, k);
            const double since = before / steps_within(before, h_max);
            double check = 0.0;
            for (int i = 0; i < NZ; ++i) check += z[i];
            if (!(fabs(check) < DIVERGED)) return k;
            sample_step(z, s, input, p, times[k], since, y, sy, columns);
            gather_sample(sum, (const row_t *)sy, y, measured + (size_t)k * NY, weight);
            /* Where a segment ends for good, nothing asks for what follows its last sample. */
            if (k + 1 >= n || (k + 1 == stop && !ends)) break;
            advance_interval(z, s, times, input, p, h_max, k, NS > 0, columns);
        }
        double *block = gram + (size_t)segment * NG * NG;
        for (int a = 0; a < NG; ++a)
            for (int b = 0; b <= a; ++b) block[a * NG + b] = block[b * NG + a] = sum[a][b];
        if (ends) memcpy(ends + (size_t)segment * NZ, z, sizeof(double) * NZ);
        if (dends) copy_rows(dends + (size_t)segment * NZ * COLUMNS, (const row_t *)s, NZ, columns);
    }
    return -1;
}
#endif
