/* Extended Kalman filter of a sampled model, with exact tangents along its own path.
 *
 * Included after trajectory.c, compiled with SELECT. Of the full state, na components are
 * uncertain ("uncertain"); behind them stand nq disturbances, each held over a step and acting
 * through a parameter of the model, ncol coloured sensor errors, and the further states of those
 * disturbances that are narrow-band: nr random components in all, whose transitions phi the caller
 * gives for every length of a step. In the basis of these the stationary covariance D is diagonal,
 * so that their fresh noise is D - phi D phi'. With
 *
 *   x- = F(x+), P- = F P F' + Q;  S = h'P h + r, g = P h, x+ = x- + g e/S, P+ = P - g g'/S
 *
 * one output at a time, columns X hold the derivatives of x by start states and parameters at
 * frozen gain, and every level of the noise carries the tangents (dm, dP) of mean and covariance.
 *
 * Rows of X, P and dP have a stride of whole vectors.
 */

static inline int round4(int n) { return (n + 3) & ~3; }

/* target += factor * source, over n numbers rounded up to whole vectors, to which every array below
 * is padded. */
static inline void axpy(double *restrict target, double factor, const double *restrict source, int n)
{
    for (int j = 0; j < n; j += 4) *(four_t *)(target + j) += factor * *(const four_t *)(source + j);
}

/* Lower triangle of gram, in blocks of four by four, plus the products of n rows; all have a stride
 * of wide, in which width is padded with zeros. */
static inline void add_products(double *restrict gram, const double *restrict rows, int n, int wide,
                                int width)
{
    for (int a = 0; a < width; a += 4)
        for (int b = 0; b <= a; b += 4) {
            double *to = gram + (size_t)a * wide + b;
            four_t sum[4];
            for (int i = 0; i < 4; ++i) sum[i] = *(four_t *)(to + (size_t)i * wide);
            for (int o = 0; o < n; ++o) {
                const double *row = rows + (size_t)o * wide;
                const four_t right = *(const four_t *)(row + b);
                for (int i = 0; i < 4; ++i) sum[i] += row[a + i] * right;
            }
            for (int i = 0; i < 4; ++i) *(four_t *)(to + (size_t)i * wide) = sum[i];
        }
}

/* Most disturbances that act through one parameter of the model. */
#define PROCESSES 4

/* States of one disturbance, at most, and random components in all. */
#define STATES 5
#define RANDOM (STATES * PROCESSES * NF + NY)

/* A row of measurement derivatives is mostly zero: its other entries, n of them. */
typedef struct {
    int n;
    int index[NZ + PROCESSES * NF + NY + 1];
    double value[NZ + PROCESSES * NF + NY + 1];
} sparse_t;

/* target <- matrix h for a symmetric matrix. */
static inline void times_sparse(double *restrict target, const double *matrix, const sparse_t *h,
                                int stride)
{
    for (int j = 0; j < stride; ++j) target[j] = 0.0;
    for (int r = 0; r < h->n; ++r)
        axpy(target, h->value[r], matrix + (size_t)h->index[r] * stride, stride);
}

static inline double dot_sparse(const sparse_t *h, const double *vector)
{
    double sum = 0.0;
    for (int r = 0; r < h->n; ++r) sum += h->value[r] * vector[h->index[r]];
    return sum;
}

static inline void keep_entry(sparse_t *h, int index, double value)
{
    if (value == 0.0) return;
    h->index[h->n] = index;
    h->value[h->n++] = value;
}

/* The transition F = [A G; 0 phi] of a step: its entries that are not zero, by rows; columns have
 * rows more, of what is certain and only passes derivatives on. */
typedef struct {
    int size, rows;   /* of the covariance, and of all with those more */
    const int *first; /* rows + 1 places in index and value */
    const int *index;
    const double *value;
} transition_t;

/* target <- F source, rows of a width known when compiled. */
static inline __attribute__((always_inline)) void moved(double *restrict target,
                                                        const transition_t *f,
                                                        const double *restrict source,
                                                        const int width)
{
    for (int i = 0; i < f->rows; ++i) {
        four_t sum[width / 4];
        for (int j = 0; j < width / 4; ++j) sum[j] = (four_t){0.0, 0.0, 0.0, 0.0};
        for (int r = f->first[i]; r < f->first[i + 1]; ++r) {
            const double value = f->value[r];
            const double *row = source + (size_t)f->index[r] * width;
            for (int j = 0; j < width / 4; ++j) sum[j] += value * *(const four_t *)(row + 4 * j);
        }
        for (int j = 0; j < width / 4; ++j) *(four_t *)(target + (size_t)i * width + 4 * j) = sum[j];
    }
}

/* matrix <- F matrix F' for a symmetric matrix; product and turned are scratch. */
static inline __attribute__((always_inline)) void sandwiched(double *restrict matrix,
                                                             const transition_t *f,
                                                             double *restrict product,
                                                             double *restrict turned,
                                                             const int stride)
{
    moved(product, f, matrix, stride);
    for (int i = 0; i < f->size; ++i)
        for (int j = 0; j < f->size; ++j)
            turned[(size_t)j * stride + i] = product[(size_t)i * stride + j];
    moved(matrix, f, turned, stride);
}

/* One scalar measurement as the tangents see it. */
typedef struct {
    sparse_t h;
    double e, inverse; /* innovation, one over its variance */
    int output, missing; /* one that is missing moves nothing */
    int corrects;        /* whether g is not zero */
    double *g;           /* P h */
    double *row, *rowq;  /* de and q of the levels */
} scalar_t;

/* Tangents of all levels stand side by side, a level a lane: entry (i, j) of a covariance at
 * PAIR(i, j), its lower triangle only. What is done to one is done to all, a vector at a time. */
#define PAIR(i, j) ((i) >= (j) ? (i) * ((i) + 1) / 2 + (j) : (j) * ((j) + 1) / 2 + (i))

static inline __attribute__((always_inline)) void add_lanes(double *restrict target, double factor,
                                                            const double *restrict source,
                                                            const int lanes)
{
    for (int j = 0; j < lanes; j += 4) *(four_t *)(target + j) += factor * *(const four_t *)(source + j);
}

/* Tangents d of the covariance and mu of the mean through the n scalar measurements of a sample;
 * white has a one where a lane's level is that of an output's white noise; v is scratch. */
static inline __attribute__((always_inline)) void levels_measured(double *restrict d,
                                                                  double *restrict mu,
                                                                  const double *restrict white,
                                                                  scalar_t *scalars, int n, int nl,
                                                                  int size, double *restrict v,
                                                                  const int lanes)
{
    for (int i = 0; i < n; ++i) {
        const scalar_t *one = scalars + i;
        const double *g = one->g, inverse = one->inverse, by_v = one->e * inverse;
        double *restrict q = one->rowq;
        double by_g[lanes], de[lanes];
        memset(v, 0, sizeof(double) * (size_t)size * lanes);
        memset(de, 0, sizeof(double) * lanes);
        memcpy(q, white + (size_t)one->output * lanes, sizeof(double) * lanes);
        for (int r = 0; r < one->h.n; ++r) {
            const int at = one->h.index[r];
            for (int j = 0; j < size; ++j)
                add_lanes(v + (size_t)j * lanes, one->h.value[r], d + (size_t)PAIR(at, j) * lanes, lanes);
            add_lanes(de, -one->h.value[r], mu + (size_t)at * lanes, lanes);
        }
        for (int r = 0; r < one->h.n; ++r)
            add_lanes(q, one->h.value[r], v + (size_t)one->h.index[r] * lanes, lanes);
        for (int j = 0; j < lanes; j += 4) {
            *(four_t *)(q + j) *= inverse;
            *(four_t *)(by_g + j) = (*(four_t *)(de + j) - *(four_t *)(q + j) * one->e) * inverse;
        }
        memcpy(one->row, de, sizeof(double) * nl);
        if (one->missing) continue;
        if (!one->corrects) { /* without a covariance only means move */
            for (int j = 0; j < size * lanes; j += 4)
                *(four_t *)(mu + j) += by_v * *(const four_t *)(v + j);
            continue;
        }
        for (int r = 0; r < size; ++r) {
            const double b = g[r] * inverse;
            double *restrict line = d + (size_t)PAIR(r, 0) * lanes, *restrict mean = mu + (size_t)r * lanes;
            four_t a[lanes / 4];
            for (int j = 0; j < lanes / 4; ++j) {
                const four_t own = *(const four_t *)(v + (size_t)r * lanes + 4 * j);
                a[j] = own * inverse - b * *(const four_t *)(q + 4 * j);
                *(four_t *)(mean + 4 * j) += by_v * own + g[r] * *(const four_t *)(by_g + 4 * j);
            }
            for (int c = 0; c <= r; ++c)
                for (int j = 0; j < lanes / 4; ++j)
                    *(four_t *)(line + (size_t)c * lanes + 4 * j) -=
                        g[c] * a[j] + b * *(const four_t *)(v + (size_t)c * lanes + 4 * j);
        }
    }
}

/* target <- row i of F times source: its lines, or with a column given those of PAIR with it. */
static inline __attribute__((always_inline)) void lanes_moved(double *restrict target,
                                                              const transition_t *f, int i,
                                                              const double *restrict source,
                                                              const int column, const int lanes)
{
    four_t sum[lanes / 4];
    for (int j = 0; j < lanes / 4; ++j) sum[j] = (four_t){0.0, 0.0, 0.0, 0.0};
    for (int r = f->first[i]; r < f->first[i + 1]; ++r) {
        const int at = f->index[r];
        const double *from = source + (size_t)(column < 0 ? at : PAIR(at, column)) * lanes;
        for (int j = 0; j < lanes / 4; ++j) sum[j] += f->value[r] * *(const four_t *)(from + 4 * j);
    }
    for (int j = 0; j < lanes / 4; ++j) *(four_t *)(target + 4 * j) = sum[j];
}

/* target <- F d F' for the tangents of all levels; line is scratch. */
static inline __attribute__((always_inline)) void levels_moved(double *restrict target,
                                                               const transition_t *f,
                                                               const double *restrict d,
                                                               double *restrict line,
                                                               const int lanes)
{
    for (int i = 0; i < f->size; ++i) {
        for (int s = 0; s < f->size; ++s) lanes_moved(line + (size_t)s * lanes, f, i, d, s, lanes);
        for (int o = 0; o <= i; ++o)
            lanes_moved(target + (size_t)PAIR(i, o) * lanes, f, o, line, -1, lanes);
    }
}

/* The same with a width that the compiler knows, where it is a common one. */
#define WIDTHS(width, CALL) \
    switch (width) { \
    case 4: CALL(4); break; \
    case 8: CALL(8); break; \
    case 12: CALL(12); break; \
    case 16: CALL(16); break; \
    case 20: CALL(20); break; \
    case 24: CALL(24); break; \
    default: CALL(width); \
    }

static ONCE void move_rows(double *target, const transition_t *f, const double *source, int width)
{
#define CALL(w) moved(target, f, source, w)
    WIDTHS(width, CALL)
#undef CALL
}

static ONCE void sandwich(double *matrix, const transition_t *f, double *product, double *turned,
                          int stride)
{
#define CALL(w) sandwiched(matrix, f, product, turned, w)
    WIDTHS(stride, CALL)
#undef CALL
}

static ONCE void measure_levels(double *d, double *mu, const double *white, scalar_t *scalars, int n,
                                int nl, int size, double *v, int lanes)
{
#define CALL(w) levels_measured(d, mu, white, scalars, n, nl, size, v, w)
    WIDTHS(lanes, CALL)
#undef CALL
}

static ONCE void move_levels(double *target, const transition_t *f, const double *d, double *line,
                             int lanes)
{
#define CALL(w) levels_moved(target, f, d, line, w)
    WIDTHS(lanes, CALL)
#undef CALL
}

/* Steps over which disturbances are held, from one sample to the next. */
static inline int parts_of_interval(const double *times, double h_sub)
{
    const int steps = (int)ceil((times[1] - times[0]) / h_sub - 1e-6);
    return steps < 1 ? 1 : steps;
}

/* Times and inputs at both ends of one of these. */
static inline void part_of_interval(const double *times, const double *input, int step, int steps,
                                    double *inner_times, double *inner_inputs)
{
    const double from = (double)step / steps, to = (double)(step + 1) / steps;
    inner_times[0] = times[0] + from * (times[1] - times[0]);
    inner_times[1] = times[0] + to * (times[1] - times[0]);
    inputs_between(input, input + NU, from, inner_inputs);
    inputs_between(input, input + NU, step + 1 == steps ? 1.0 : to, inner_inputs + NU);
}

enum {
    FORCE_VARIANCE,
    FORCE_TIME,
    WHITE_VARIANCE,
    COLOUR_VARIANCE,
    COLOUR_TIME,
    SEA_VARIANCE,
    SEA_PERIOD,
    SEA_DAMPING
};

/* Disturbances into the parameters through which they act, several perhaps through one. */
static inline void let_act(double *p, int nq, const int *q_index, const double *acting)
{
    for (int j = 0; j < nq; ++j) p[q_index[j]] = 0.0;
    for (int j = 0; j < nq; ++j) p[q_index[j]] += acting[j];
}

/* target, the transition since a sample, after one more step; dense rows of size numbers. */
static ONCE void keep_move(double *target, const transition_t *f, int step, double *product,
                           double *turned)
{
    const int size = f->size, stride = round4(size);
    memset(product, 0, sizeof(double) * (size_t)size * stride);
    for (int i = 0; i < size; ++i)
        for (int j = 0; j < size; ++j)
            product[(size_t)i * stride + j] = step ? target[(size_t)i * size + j] : i == j;
    move_rows(turned, f, product, stride);
    for (int i = 0; i < size; ++i)
        memcpy(target + (size_t)i * size, turned + (size_t)i * stride, sizeof(double) * size);
}

/* The rows of phi (nr x nr) behind `count` entries of the na rows above; how many there are then. */
static inline int keep_memory(int *first, int *index, double *value, int count, const double *phi,
                              int na, int nr)
{
    for (int i = 0; i < nr; ++i) {
        first[na + i] = count;
        for (int j = 0; j < nr; ++j) {
            if (phi[(size_t)i * nr + j] == 0.0) continue;
            index[count] = na + j;
            value[count++] = phi[(size_t)i * nr + j];
        }
    }
    first[na + nr] = count;
    return count;
}

/* The states of one process among the nr random components. */
typedef struct {
    int n, at[STATES];
} states_t;

static inline states_t states_of(const int *owner, int nr, int process)
{
    states_t found = {0};
    for (int i = 0; i < nr; ++i)
        if (owner[i] == process) found.at[found.n++] = i;
    return found;
}

/* Sum of a b' over the columns of one process. */
static inline double shared(const double *a, const double *b, const states_t *of)
{
    double sum = 0.0;
    for (int c = 0; c < of->n; ++c) sum += a[of->at[c]] * b[of->at[c]];
    return sum;
}

/* Lane l of dP += I - phi phi', the fresh noise of a process of unit variance. */
static inline void add_fresh_lane(double *dP, int l, int lanes, const double *phi, int na, int nr,
                                  const states_t *of)
{
    for (int r = 0; r < of->n; ++r)
        for (int c = 0; c <= r; ++c) {
            const int i = of->at[r], j = of->at[c];
            const double left = shared(phi + (size_t)i * nr, phi + (size_t)j * nr, of);
            dP[(size_t)PAIR(na + i, na + j) * lanes + l] += (i == j) - left;
        }
}

/* Lane l of the tangents, for a change of phi in the rows of one process:
 * dm += dF m and dP += dF P F' + F P dF' - variance (dphi phi' + phi dphi'), the covariance still
 * being the one before the step; columns is scratch of STATES strides. */
static void add_changed_memory(double *dP, double *dm, int l, int lanes, const transition_t *f, int na,
                               int nr, const states_t *of, const double *phi, const double *change,
                               double variance, const double *P, const double *mean, double *columns,
                               int stride)
{
    for (int c = 0; c < of->n; ++c) { /* columns of F P */
        double *column = columns + (size_t)c * stride;
        const double *from = P + (size_t)(na + of->at[c]) * stride;
        for (int i = 0; i < f->size; ++i) {
            column[i] = 0.0;
            for (int e = f->first[i]; e < f->first[i + 1]; ++e) column[i] += f->value[e] * from[f->index[e]];
        }
    }
    for (int r = 0; r < of->n; ++r) {
        const int i = na + of->at[r];
        const double *by = change + (size_t)of->at[r] * nr;
        dm[(size_t)i * lanes + l] += shared(by, mean + na, of);
        for (int j = 0; j < f->size; ++j) {
            double moved = 0.0;
            for (int c = 0; c < of->n; ++c) moved += by[of->at[c]] * columns[(size_t)c * stride + j];
            dP[(size_t)PAIR(i, j) * lanes + l] += (i == j ? 2.0 : 1.0) * moved;
        }
        for (int c = 0; c < of->n; ++c) { /* each of two rows gives one half of what stands between */
            const int j = na + of->at[c];
            const double fresh = variance * shared(by, phi + (size_t)of->at[c] * nr, of);
            dP[(size_t)PAIR(i, j) * lanes + l] -= (i == j ? 2.0 : 1.0) * fresh;
        }
    }
}

/* Process of which a level is the variance, or -1: disturbances of first order come first, then
 * those of seas, then colours. */
static inline int level_at(int kind, int index, int n_first, int nq)
{
    if (kind == FORCE_VARIANCE) return index;
    if (kind == SEA_VARIANCE) return n_first + index;
    return kind == COLOUR_VARIANCE ? nq + index : -1;
}

/* fresh <- D - phi D phi', D being diagonal. */
static inline void fresh_noise(double *fresh, const double *phi, const double *variance, int nr)
{
    for (int i = 0; i < nr; ++i)
        for (int j = 0; j < nr; ++j) {
            double *to = fresh + (size_t)i * nr + j;
            *to = i == j ? variance[i] : 0.0;
            for (int c = 0; c < nr; ++c)
                *to -= phi[(size_t)i * nr + c] * variance[c] * phi[(size_t)j * nr + c];
        }
}

/* mean <- phi mean of the random components. */
static inline void remember(double *mean, const double *phi, int nr, double *scratch)
{
    for (int i = 0; i < nr; ++i) {
        scratch[i] = 0.0;
        for (int j = 0; j < nr; ++j) scratch[i] += phi[(size_t)i * nr + j] * mean[j];
    }
    memcpy(mean, scratch, sizeof(double) * nr);
}

/* Doubles of scratch that kernel_filter needs. */
size_t kernel_filter_work(int na, int more, int nq, int nr, int nx, int nl)
{
    const size_t n = na + nr, stride = round4((int)n), wide = round4(nx + nl + 1);
    return n * stride * 3 + 2 * (n + more) * round4(nx) + (n * (n + 1) + 4 * n + NY) * round4(nl) +
           (3 + STATES) * stride + (size_t)na * (na + nq) + (size_t)(na + more) * (na + nq + more) +
           (size_t)2 * STATES * nr + (size_t)nr * nr +
           NY * (stride + 2 * wide) + (round4(nl) + 1) * wide + wide * wide + 64;
}

/* Filter one record.
 *
 * n, times, inputs, p0, h_max as of kernel_run; h_sub, longest step of the noise;
 * z0 (NZ); uncertain (na + more), positions in the full state of na uncertain components, then of
 * those without an error that only pass derivatives on;
 * nx columns of X of which the last np are parameters; in the rows of sensitivities those stand
 * from c_parameter, disturbances from c_disturbance; columns (NF) maps
 * each free parameter to its place in these rows or to -1; x0 (na + more x nx) start of X;
 * nq, q_index (nq) positions of the disturbances in p, q_column (nq) their columns there, of which
 * there are nd; q_sea (nq), number of the sea of which it is a part, or -1: seas come last;
 * white (NY) variances; ncol, c_output (ncol);
 * nr random components: disturbances, colours, then further states of disturbances; owner (nr) the
 * process of each, variance (nr); which (n - 1 x 2) of the transitions are those of the steps after
 * each sample, of all but the last and of this one, towards a step of perhaps another length;
 * memory (n_transitions x 3 x nr x nr) these, their derivatives by the logarithms of all times
 * and periods, and of all dampings;
 * measured (n x NY), NaN where missing; beyond (n x NY) the largest e^2/S with which a sample moves
 * anything, NULL for any; nl, l_kind, l_index (nl), -1 for the time of all.
 * Results, each but gram may be NULL: gram ((nx + nl + 1)^2) the sum of [de e]'[de e]/S; level
 * (nl + nl^2) half gradient sum q(1 - e^2/S)/2 and sum q q'/2 of the levels, q = d log S;
 * e, s (n x NY) innovations, NaN where missing, and their variances; rows (n x NY x (nx + 2 nl)) of
 * de/sqrt(S), then q of the levels, missing samples included; path (n x (NZ + nq + ncol)) filtered
 * means; gains (n x NY x 2 size) h, then g/S, missing samples included; moves (n x (size + nq) x size) F
 * towards the next sample, zero at the last one, and below it the rows of the disturbances in P-;
 * total (2) sums of log S and e^2/S.
 * Returns -1, or the first sample at which something is not finite or S is not positive.
 */
int kernel_filter(int n, const double *times, const double *inputs, const double *p0, double h_max,
                  double h_sub, const double *z0, int na, int more, const int *uncertain, int nx, int np,
                  int c_parameter, int c_disturbance, const int *columns, const double *x0, int nq, int nd, const int *q_index,
                  const int *q_column, const int *q_sea, const double *white, int ncol,
                  const int *c_output, int nr, const int *owner, const double *variance,
                  const int *which, const double *memory, const double *measured, const double *beyond,
                  int nl, const int *l_kind, const int *l_index,
                  double *gram_out, double *level_out, double *e_out, double *s_out,
                  double *rows_out, double *path_out, double *gains_out, double *moves_out, double *total,
                  double *work)
{
    int n_first = 0; /* disturbances of first order */
    for (int j = 0; j < nq; ++j) n_first += q_sea[j] < 0;
    const int m = na + nq, tail = m + ncol, size = na + nr;
    const int stride = round4(size), sx = round4(nx);
    const int width = nx + nl + 1, wide = round4(width), lanes = round4(nl);
    const size_t block_moves = (size_t)(size + nq) * size;
    const size_t block = (size_t)size * stride, pairs = (size_t)size * (size + 1) / 2 * lanes;
    double *P = work, *product = P + block, *turned = product + block, *dP = turned + block;
    double *dPnext = dP + pairs, *dm = dPnext + pairs, *dmnext = dm + (size_t)size * lanes;
    double *v = dmnext + (size_t)size * lanes, *line = v + (size_t)size * lanes;
    double *white_lanes = line + (size_t)size * lanes;
    double *X = white_lanes + (size_t)NY * lanes, *Xnext = X + (size_t)(size + more) * sx;
    double *delta = Xnext + (size_t)(size + more) * sx, *mean = delta + stride;
    double *column = mean + stride, *fresh = column + STATES * stride;
    double *entries = fresh + (size_t)nr * nr, *passed = entries + (size_t)na * m + STATES * nr;
    double *gains = passed + (size_t)(na + more) * (m + more) + STATES * nr;
    double *rows = gains + (size_t)NY * stride;
    double *rowsq = rows + (size_t)NY * wide, *slope = rowsq + (size_t)NY * wide;
    double *information = slope + wide, *gram = information + (size_t)lanes * wide;
    int place[NZ * (NZ + PROCESSES * NF) + STATES * RANDOM + 1], first_of[NZ + RANDOM + 1];
    int passed_place[NZ * (NZ + PROCESSES * NF) + STATES * RANDOM + 1];
    int first_passed[NZ + RANDOM + 1], sensors_remember = 0, last = -1;
    const double *phi = memory;
    const int c_passing = c_disturbance + nd;
    scalar_t scalars[MAX1(NY)];
    const transition_t step_of = {size, size, first_of, place, entries};
    const transition_t columns_of = {size, size + more, first_passed, passed_place, passed};
    double z[MAX1(NZ)], seen[MAX1(NZ)], y[MAX1(NY)], p[MAX1(NP)];
    SCRATCH row_t s[MAX1(NZ)], sy[MAX1(NY)];
    double sum_log = 0.0, sum_square = 0.0, product_s = 1.0;
    active_width(c_passing + more);
    column_of = columns;
    memset(work, 0, sizeof(double) * (size_t)(gram - work));
    memset(gram, 0, sizeof(double) * (size_t)wide * wide);
    memcpy(z, z0, sizeof(double) * NZ);
    memcpy(p, p0, sizeof(double) * NP);
    let_act(p, nq, q_index, mean + na);
    for (int i = 0; i < na + more; ++i)
        for (int j = 0; j < nx; ++j)
            X[(size_t)(i < na ? i : size + i - na) * sx + j] = x0[(size_t)i * nx + j];
    for (int i = 0; i < nr; ++i) P[(size_t)(na + i) * (stride + 1)] = variance[i];
    for (int l = 0; l < nl; ++l) {
        const int at = level_at(l_kind[l], l_index[l], n_first, nq);
        for (int i = 0; i < nr; ++i)
            if (owner[i] == at) dP[(size_t)PAIR(na + i, na + i) * lanes + l] = 1.0;
        if (l_kind[l] == WHITE_VARIANCE) white_lanes[(size_t)l_index[l] * lanes + l] = 1.0;
    }
    for (int i = 0; i < na; ++i) sensors_remember |= uncertain[i] >= NX + NA;
    for (int k = 0; k < n; ++k) {
        const double *input = inputs + (size_t)k * NU;
        const double since = k > 0 ? times[k] - times[k - 1] : (n > 1 ? times[1] - times[0] : 1.0);
        double check = 0.0;
        for (int i = 0; i < NZ; ++i) check += z[i];
        if (!(fabs(check) < DIVERGED)) return k;
        memcpy(seen, z, sizeof z);
        if (moves_out)
            for (int j = 0; j < nq; ++j)
                memcpy(moves_out + (size_t)k * block_moves + (size_t)(size + j) * size,
                       P + (size_t)(na + j) * stride, sizeof(double) * size);
        clear_rows(s, NZ);
        for (int i = 0; i < na; ++i) s[uncertain[i]][i] = 1.0;
        for (int i = 0; i < more; ++i) s[uncertain[na + i]][c_passing + i] = 1.0;
        sample_step(seen, s, input, p, times[k], since, y, sy, 1);
        for (int i = 0; i < stride; ++i) delta[i] = 0.0;
        int n_scalars = 0;
        /* Covariance, mean and columns first: levels follow from what is kept of each scalar. */
        for (int i = 0; i < NY; ++i) {
            const double value = measured[(size_t)k * NY + i];
            int missing = isnan(value);
            scalar_t *one = scalars + n_scalars;
            sparse_t *hs = &one->h;
            double *g = gains + (size_t)n_scalars * stride, *row = rows + (size_t)n_scalars * wide;
            if (e_out) e_out[(size_t)k * NY + i] = NAN;
            if (missing && !s_out && !rows_out) continue;
            double e = missing ? 0.0 : value - y[i];
            hs->n = 0;
            for (int j = 0; j < na; ++j) keep_entry(hs, j, sy[i][j]);
            for (int j = 0; j < nq; ++j) keep_entry(hs, na + j, sy[i][c_disturbance + q_column[j]]);
            for (int j = 0; j < ncol; ++j)
                if (c_output[j] == i) {
                    keep_entry(hs, m + j, 1.0);
                    e -= mean[m + j];
                }
            e -= dot_sparse(hs, delta);
            times_sparse(g, P, hs, stride);
            const double S = dot_sparse(hs, g) + white[i];
            if (!(S > 0.0) || !isfinite(e)) return k;
            const double inverse = 1.0 / S;
            if (e_out && !missing) e_out[(size_t)k * NY + i] = e;
            if (beyond) missing |= e * e * inverse > beyond[(size_t)k * NY + i];
            if (gains_out) {
                double *kept = gains_out + ((size_t)k * NY + i) * 2 * size;
                for (int r = 0; r < hs->n; ++r) kept[hs->index[r]] = hs->value[r];
                for (int j = 0; j < size; ++j) kept[size + j] = g[j] * inverse;
            }
            for (int j = 0; j < wide; ++j) row[j] = 0.0;
            for (int j = 0; j < np; ++j) row[nx - np + j] = -sy[i][c_parameter + j];
            for (int r = 0; r < hs->n; ++r) axpy(row, -hs->value[r], X + (size_t)hs->index[r] * sx, nx);
            for (int j = 0; j < more; ++j)
                if (sy[i][c_passing + j] != 0.0)
                    axpy(row, -sy[i][c_passing + j], X + (size_t)(size + j) * sx, nx);
            if (s_out) s_out[(size_t)k * NY + i] = S;
            one->inverse = inverse;
            one->output = i;
            one->missing = missing;
            one->corrects = 0;
            for (int r = 0; r < size; ++r) one->corrects |= g[r] != 0.0;
            one->g = g;
            one->row = row + nx;
            one->rowq = rowsq + (size_t)n_scalars * wide;
            n_scalars += !missing || rows_out;
            if (missing) continue;
            for (int r = 0; r < size; ++r) axpy(X + (size_t)r * sx, g[r] * inverse, row, nx);
            for (int r = 0; r < size; ++r) axpy(P + (size_t)r * stride, -g[r] * inverse, g, stride);
            axpy(delta, e * inverse, g, size);
            one->e = e;
            const double square = e * e * inverse;
            /* One logarithm for many variances. */
            product_s *= S;
            if (product_s < 1e-200 || product_s > 1e200) {
                sum_log += log(product_s);
                product_s = 1.0;
            }
            sum_square += square;
        }
        if (nl > 0) measure_levels(dP, dm, white_lanes, scalars, n_scalars, nl, size, v, lanes);
        for (int o = 0; o < n_scalars; ++o) {
            const scalar_t *one = scalars + o;
            double *row = rows + (size_t)o * wide;
            const double *rowq = one->rowq, root = sqrt(one->inverse);
            for (int a = 0; a < nx + nl; ++a) row[a] *= root;
            if (rows_out) {
                double *target = rows_out + ((size_t)k * NY + one->output) * (nx + 2 * nl);
                memcpy(target, row, sizeof(double) * (nx + nl));
                if (!one->missing) memcpy(target + nx + nl, rowq, sizeof(double) * nl);
            }
            if (one->missing) { /* moves nothing */
                memset(row, 0, sizeof(double) * wide);
                memset(one->rowq, 0, sizeof(double) * wide);
                continue;
            }
            row[nx + nl] = root * one->e;
            axpy(slope, 0.5 * (1.0 - one->e * one->e * one->inverse), rowq, nl);
        }
        add_products(gram, rows, n_scalars, wide, width);
        add_products(information, rowsq, n_scalars, wide, nl);
        for (int i = 0; i < na; ++i) z[uncertain[i]] += delta[i];
        for (int i = na; i < size; ++i) mean[i] += delta[i];
        if (path_out) {
            double *path = path_out + (size_t)k * (NZ + nq + ncol);
            memcpy(path, z, sizeof(double) * NZ);
            for (int i = na; i < tail; ++i) path[NZ + i - na] = mean[i];
        }
        if (k + 1 >= n) break;
        /* Towards the next sample, in steps over which the disturbances are held. */
        const int steps = parts_of_interval(times + k, h_sub);
        for (int step = 0; step < steps; ++step) {
            const int now = which[2 * k + (step + 1 == steps)];
            if (now != last) {
                last = now;
                phi = memory + (size_t)last * 3 * nr * nr;
                fresh_noise(fresh, phi, variance, nr);
            }
            double inner_times[2], inner_inputs[2 * MAX1(NU)];
            part_of_interval(times + k, input, step, steps, inner_times, inner_inputs);
            let_act(p, nq, q_index, mean + na);
            clear_rows(s, NZ);
            for (int i = 0; i < na; ++i) s[uncertain[i]][i] = 1.0;
            for (int i = 0; i < more; ++i) s[uncertain[na + i]][c_passing + i] = 1.0;
            /* Sensor memory moves on with what is known after the measurement. */
            if (NS > 0 && step == 0) {
                if (sensors_remember)
                    sample_step(z, s, input, p, times[k], since, y, sy, 1);
                else /* that of sensors without an error, which nothing reads */
                    memcpy(z + NX + NA, seen + NX + NA, sizeof(double) * NS);
            }
            advance_interval(z, s, inner_times, inner_inputs, p, h_max, 0, 1);
            int count_entries = 0;
            for (int i = 0; i < na; ++i) {
                const double *row = s[uncertain[i]];
                first_of[i] = count_entries;
                for (int l = 0; l < m; ++l) {
                    const double value = l < na ? row[l] : row[c_disturbance + q_column[l - na]];
                    if (value == 0.0) continue;
                    place[count_entries] = l;
                    entries[count_entries++] = value;
                }
            }
            keep_memory(first_of, place, entries, count_entries, phi, na, nr);
            if (moves_out)
                keep_move(moves_out + (size_t)k * block_moves, &step_of, step, product, turned);
            if (nx > 0) {
                double *before = X;
                int n_passed = 0;
                for (int i = 0; i < na + more; ++i) {
                    const double *row = s[uncertain[i]];
                    if (i == na) n_passed = keep_memory(first_passed, passed_place, passed, n_passed, phi, na, nr);
                    first_passed[i < na ? i : size + i - na] = n_passed;
                    for (int l = 0; l < m + more; ++l) {
                        const double value = l < na  ? row[l]
                                             : l < m ? row[c_disturbance + q_column[l - na]]
                                                     : row[c_passing + l - m];
                        if (value == 0.0) continue;
                        passed_place[n_passed] = l < m ? l : size + l - m;
                        passed[n_passed++] = value;
                    }
                }
                if (more == 0) n_passed = keep_memory(first_passed, passed_place, passed, n_passed, phi, na, nr);
                first_passed[size + more] = n_passed;
                move_rows(Xnext, &columns_of, X, sx);
                for (int i = 0; i < na + more; ++i)
                    for (int j = 0; j < np; ++j)
                        Xnext[(size_t)(i < na ? i : size + i - na) * sx + nx - np + j] +=
                            s[uncertain[i]][c_parameter + j];
                X = Xnext;
                Xnext = before;
            }
            if (nl > 0) {
                double *before = dP;
                move_levels(dPnext, &step_of, dP, line, lanes);
                dP = dPnext;
                dPnext = before;
                before = dm;
                move_rows(dmnext, &step_of, dm, lanes);
                dm = dmnext;
                dmnext = before;
            }
            for (int l = 0; l < nl; ++l) {
                const int kind = l_kind[l], index = l_index[l];
                const int at = level_at(kind, index, n_first, nq);
                if (at >= 0) {
                    const states_t of = states_of(owner, nr, at);
                    add_fresh_lane(dP, l, lanes, phi, na, nr, &of);
                }
                for (int j = 0; j < nq + ncol; ++j) {
                    /* One time, or with index -1 that of all; period and damping those of a sea. */
                    int hit = j < nq ? kind == FORCE_TIME && q_sea[j] < 0 : kind == COLOUR_TIME;
                    hit = hit && (index < 0 || index == (j < nq ? j : j - nq));
                    hit |= j < nq && (kind == SEA_PERIOD || kind == SEA_DAMPING) && q_sea[j] == index;
                    if (!hit) continue;
                    const double *change = phi + (size_t)(kind == SEA_DAMPING ? 2 : 1) * nr * nr;
                    const states_t of = states_of(owner, nr, j);
                    add_changed_memory(dP, dm, l, lanes, &step_of, na, nr, &of, phi, change,
                                       variance[j], P, mean, column, stride);
                }
            }
            sandwich(P, &step_of, product, turned, stride);
            for (int i = 0; i < nr; ++i)
                for (int j = 0; j < nr; ++j)
                    P[(size_t)(na + i) * stride + na + j] += fresh[(size_t)i * nr + j];
            remember(mean + na, phi, nr, column);
        }
        let_act(p, nq, q_index, mean + na);
    }
    for (int a = 0; a < width; ++a)
        for (int b = 0; b <= a; ++b)
            gram_out[(size_t)a * width + b] = gram_out[(size_t)b * width + a] = gram[(size_t)a * wide + b];
    if (level_out)
        for (int l = 0; l < nl; ++l) {
            level_out[l] = slope[l];
            for (int j = 0; j <= l; ++j)
                level_out[nl + (size_t)l * nl + j] = level_out[nl + (size_t)j * nl + l] =
                    0.5 * information[(size_t)l * wide + j];
        }
    if (total) {
        total[0] = sum_log + log(product_s);
        total[1] = sum_square;
    }
    return -1;
}

/* Innovations e (n x NY) of other values at gains that a pass of kernel_filter has kept.
 *
 * No derivative is needed: a fraction of the cost. Arguments as there; gains as kept, for the
 * same uncertain components, disturbances and colours.
 */
int kernel_replay(int n, const double *times, const double *inputs, const double *p0, double h_max,
                  double h_sub, const double *z0, int na, const int *uncertain, int nq,
                  const int *q_index, int ncol, const int *c_output, int nr, const int *which,
                  const double *memory, const double *measured, const double *gains, double *e_out,
                  double *mean, double *delta)
{
    const int m = na + nq, size = na + nr;
    double z[MAX1(NZ)], seen[MAX1(NZ)], y[MAX1(NY)], p[MAX1(NP)];
    memcpy(z, z0, sizeof(double) * NZ);
    memcpy(p, p0, sizeof(double) * NP);
    for (int i = 0; i < size; ++i) mean[i] = 0.0;
    let_act(p, nq, q_index, mean + na);
    for (int k = 0; k < n; ++k) {
        const double *input = inputs + (size_t)k * NU;
        const double since = k > 0 ? times[k] - times[k - 1] : (n > 1 ? times[1] - times[0] : 1.0);
        double check = 0.0;
        for (int i = 0; i < NZ; ++i) check += z[i];
        if (!(fabs(check) < DIVERGED)) return k;
        memcpy(seen, z, sizeof z);
        sample_step(seen, NULL, input, p, times[k], since, y, NULL, 0);
        for (int i = 0; i < size; ++i) delta[i] = 0.0;
        for (int i = 0; i < NY; ++i) {
            const double value = measured[(size_t)k * NY + i];
            const double *h = gains + ((size_t)k * NY + i) * 2 * size, *gain = h + size;
            e_out[(size_t)k * NY + i] = NAN;
            if (isnan(value)) continue;
            double e = value - y[i];
            for (int j = 0; j < ncol; ++j)
                if (c_output[j] == i) e -= mean[m + j];
            for (int j = 0; j < size; ++j) e -= h[j] * delta[j];
            if (!isfinite(e)) return k;
            for (int j = 0; j < size; ++j) delta[j] += gain[j] * e;
            e_out[(size_t)k * NY + i] = e;
        }
        for (int i = 0; i < na; ++i) z[uncertain[i]] += delta[i];
        for (int i = na; i < size; ++i) mean[i] += delta[i];
        if (k + 1 >= n) break;
        const int steps = parts_of_interval(times + k, h_sub);
        for (int step = 0; step < steps; ++step) {
            double inner_times[2], inner_inputs[2 * MAX1(NU)];
            part_of_interval(times + k, input, step, steps, inner_times, inner_inputs);
            let_act(p, nq, q_index, mean + na);
            if (NS > 0 && step == 0) sample_step(z, NULL, input, p, times[k], since, y, NULL, 0);
            advance_interval(z, NULL, inner_times, inner_inputs, p, h_max, 0, 0);
            const int now = which[2 * k + (step + 1 == steps)];
            remember(mean + na, memory + (size_t)now * 3 * nr * nr, nr, delta);
        }
        let_act(p, nq, q_index, mean + na);
    }
    return -1;
}
