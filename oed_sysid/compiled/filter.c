/* Extended Kalman filter of a sampled model, with exact tangents along its own path.
 *
 * Included after trajectory.c, compiled with SELECT. Of the full state, na components are
 * uncertain ("uncertain"); behind them stand nq disturbances, each held over a step and acting
 * through a parameter of the model, ncol coloured sensor errors, and the further states of those
 * disturbances that are narrow-band: nr random components in all, of stationary covariance D, whose
 * transitions phi the caller gives for every length of a step: D - phi D phi' joins over it. With
 *
 *   x- = F(x+), P- = F P F' + Q;  S = h'P h + r, g = P h, x+ = x- + g e/S, P+ = P - g g'/S
 *
 * one output at a time, columns X hold the derivatives of x by start states and parameters at
 * frozen gain, and every level of the noise carries the tangents (dm, dP) of mean and covariance.
 *
 * P, X and dm of all levels stand side by side in the rows of one matrix J = [P X dm]. With c = h' J
 * and what parameters do to the output itself, a measurement is J -= g c / S, as far as the gain is
 * frozen, and a step is F J. Each part of a row is padded with zeros to whole vectors.
 */

static inline int round4(int n) { return (n + 3) & ~3; }

/* target += factor * source, over n numbers rounded up to whole vectors, to which every array below
 * is padded. */
static inline void axpy(double *restrict target, double factor, const double *restrict source, int n)
{
    for (int j = 0; j < n; j += 4) *(four_t *)(target + j) += factor * *(const four_t *)(source + j);
}

/* Most disturbances that act through one parameter of the model. */
#define PROCESSES 4

/* States of one disturbance, at most, and random components in all. */
#define STATES 6
#define RANDOM (STATES * PROCESSES * NF + NY)

/* A row of measurement derivatives is mostly zero: its other entries, n of them. */
typedef struct {
    int n;
    int index[NZ + RANDOM + 1];
    double value[NZ + RANDOM + 1];
} sparse_t;

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

/* The transition F = [A G; 0 phi] of a step: its entries that are not zero, by rows. The first
 * `size` rows and columns are of the covariance; behind them stands what is certain and only passes
 * derivatives on. */
typedef struct {
    int size, rows;
    int first[NZ + RANDOM + 1]; /* rows + 1 places in index and value */
    int index[NZ * (NZ + PROCESSES * NF) + STATES * RANDOM + 1];
    double *value;
} transition_t;

/* Some vectors of row i of F source; in the target they stand `apart`. */
static inline __attribute__((always_inline)) void moved_block(double *restrict target, int apart,
                                                              const transition_t *f, int i,
                                                              const double *restrict source,
                                                              int stride, const int n)
{
    four_t sum[8] = {{0.0}};
    for (int r = f->first[i]; r < f->first[i + 1]; ++r) {
        const double value = f->value[r], *from = source + (size_t)f->index[r] * stride;
        UNROLLED
        for (int j = 0; j < n; ++j) sum[j] += value * *(const four_t *)(from + 4 * j);
    }
    UNROLLED
    for (int j = 0; j < n; ++j) *(four_t *)(target + (size_t)j * apart) = sum[j];
}

/* Row i of F source, its first vectors. */
static inline __attribute__((always_inline)) void moved_row(double *target, int apart,
                                                            const transition_t *f, int i,
                                                            const double *source, int stride,
                                                            int vectors)
{
#define BLOCKS(n)                                                                                  \
    for (; vectors >= n; vectors -= n, source += 4 * n, target += (size_t)n * apart)               \
        moved_block(target, apart, f, i, source, stride, n);
    BLOCKS(8) BLOCKS(4) BLOCKS(2) BLOCKS(1)
#undef BLOCKS
}

/* target <- F source, its first n rows; of the source they have a stride of width. */
static ONCE void moved(double *target, int stride, const transition_t *f, int n, const double *source,
                       int width)
{
    for (int i = 0; i < n; ++i)
        moved_row(target + (size_t)i * stride, 4, f, i, source, width, width / 4);
}

/* Tangents of four levels stand side by side as the entries of one matrix, of which the lower triangle
 * counts: what is done to one is done to all. Entry (i, j) is at PAIR(i, j). */
#define PAIR(i, j, size) ((i) >= (j) ? (i) * (size) + (j) : (j) * (size) + (i))

/* dP <- F dP F' of four levels, by way of its transpose F dP. */
static ONCE void moved_levels(four_t *dP, const transition_t *f, four_t *across)
{
    const int size = f->size, stride = 4 * size;
    for (int i = 0; i < size; ++i)
        for (int j = 0; j < i; ++j) dP[j * size + i] = dP[i * size + j];
    for (int i = 0; i < size; ++i)
        moved_row((double *)(across + i), stride, f, i, (double *)dP, stride, size);
    for (int i = 0; i < size; ++i)
        moved_row((double *)(dP + i * size), 4, f, i, (double *)across, stride, i + 1);
}

/* Tangents dP of the covariance through a scalar measurement, and what the change of the gain adds
 * to those dm of the mean, all of four levels; q has that of S for a change of the white noise
 * alone, and then d log S. */
static ONCE void measure_levels(four_t *restrict dP, double *restrict dm, int stride,
                                double *restrict q, const sparse_t *h, const double *restrict g,
                                double e, double inverse, int moves, int corrects, int size)
{
    four_t v[MAX1(NZ) + RANDOM], own = *(four_t *)q;
    for (int j = 0; j < size; ++j) v[j] = (four_t){0.0, 0.0, 0.0, 0.0};
    for (int r = 0; r < h->n; ++r) {
        const int at = h->index[r];
        for (int j = 0; j < at; ++j) v[j] += h->value[r] * dP[at * size + j];
        for (int j = at; j < size; ++j) v[j] += h->value[r] * dP[j * size + at];
    }
    for (int r = 0; r < h->n; ++r) own += h->value[r] * v[h->index[r]];
    *(four_t *)q = own *= inverse;
    for (int r = 0; r < (moves ? size : 0); ++r) {
        const four_t a = (v[r] - g[r] * own) * inverse;
        const double b = g[r] * inverse;
        const int n = corrects ? r + 1 : 0; /* without a covariance only means move */
        *(four_t *)(dm + (size_t)r * stride) += e * a;
        for (int c = 0; c < n; ++c) dP[r * size + c] -= g[c] * a + b * v[c];
    }
}

/* Steps over which disturbances are held in an interval between samples. */
static inline int parts_of_interval(double interval, double h_sub)
{
    const int steps = (int)ceil(interval / h_sub - 1e-6);
    return steps < 1 ? 1 : steps;
}

/* Length of the last integration step before sample k. */
static inline double step_before(const double *times, int n, int k, double h_sub, double h_max)
{
    const double interval = interval_before(times, n, k);
    const double held = interval / parts_of_interval(interval, h_sub);
    return held / steps_within(held, h_max);
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

/* Disturbances into the parameters through which they act, several perhaps through one. */
static inline void let_act(double *p, int nq, const int *q_index, const double *acting)
{
    for (int j = 0; j < nq; ++j) p[q_index[j]] = 0.0;
    for (int j = 0; j < nq; ++j) p[q_index[j]] += acting[j];
}

/* target, the transition since a sample, after one more step; dense rows of size numbers. */
static ONCE void keep_move(double *target, const transition_t *f, int step, double *before,
                           double *after)
{
    const int size = f->size, stride = round4(size);
    for (int i = 0; i < size; ++i)
        for (int j = 0; j < size; ++j)
            before[(size_t)i * stride + j] = step ? target[(size_t)i * size + j] : i == j;
    moved(after, stride, f, size, before, stride);
    for (int i = 0; i < size; ++i)
        memcpy(target + (size_t)i * size, after + (size_t)i * stride, sizeof(double) * size);
}

/* F from rows of sensitivities, in which `place` has each of its columns but those of the random
 * components' own transition phi (nr x nr). */
static ONCE void keep_transition(transition_t *f, const row_t *s, const int *uncertain,
                                 const int *place, const double *phi, int na, int nq, int nr)
{
    const int m = na + nq, columns = m + f->rows - f->size;
    int count = 0;
    for (int i = 0; i < f->rows; ++i) {
        f->first[i] = count;
        if (i >= na && i < f->size) {
            const double *row = phi + (size_t)(i - na) * nr;
            for (int l = 0; l < nr; ++l)
                if (row[l] != 0.0) f->index[count] = na + l, f->value[count++] = row[l];
            continue;
        }
        const double *row = s[uncertain[i < na ? i : i - nr]];
        for (int l = 0; l < columns; ++l) {
            const double value = row[place[l]];
            if (value != 0.0) f->index[count] = l < m ? l : f->size + l - m, f->value[count++] = value;
        }
    }
    f->first[f->rows] = count;
}

/* Tangents of level l, for a change of phi: dm += dF m and dP += dF P F' + F P dF'; FP, of the
 * covariance before the step, and dm have a stride. */
static void add_changed_memory(four_t *dP, double *dm, int l, int na, int nr, int size,
                               const double *change, const double *FP, int stride, const double *mean)
{
    sparse_t by;
    for (int r = 0; r < nr; ++r) {
        const int i = na + r;
        by.n = 0;
        for (int c = 0; c < nr; ++c) keep_entry(&by, na + c, change[(size_t)r * nr + c]);
        if (by.n == 0) continue;
        dm[(size_t)i * stride + l] += dot_sparse(&by, mean);
        for (int j = 0; j < size; ++j)
            dP[PAIR(i, j, size)][l % 4] +=
                (i == j ? 2.0 : 1.0) * dot_sparse(&by, FP + (size_t)j * stride);
    }
}

/* Tangents dP of every four levels, `apart`, += those of the random components' own covariance. */
static void add_random(four_t *dP, size_t apart, const double *by, int na, int nr, int size, int lanes)
{
    for (int l = 0; l < lanes; l += 4, dP += apart)
        for (int i = 0; i < nr; ++i)
            for (int j = 0; j <= i; ++j)
                dP[(na + i) * size + na + j] += *(const four_t *)(by + ((size_t)i * nr + j) * lanes + l);
}

/* fresh <- D - phi D phi', its lower triangle, of some lanes side by side; phi are rows of F. */
static void fresh_noise(double *fresh, const transition_t *f, int na, const double *D, int nr, int lanes,
                        double *across)
{
    for (int i = 0; i < nr; ++i) {
        for (int j = 0; j < nr * lanes; ++j) across[j] = 0.0;
        for (int r = f->first[na + i]; r < f->first[na + i + 1]; ++r) {
            const double *from = D + (size_t)(f->index[r] - na) * nr * lanes;
            for (int j = 0; j < nr * lanes; ++j) across[j] += f->value[r] * from[j];
        }
        for (int j = 0; j <= i; ++j) {
            const size_t at = ((size_t)i * nr + j) * lanes;
            for (int l = 0; l < lanes; ++l) fresh[at + l] = D[at + l];
            for (int r = f->first[na + j]; r < f->first[na + j + 1]; ++r) {
                const double *by = across + (size_t)(f->index[r] - na) * lanes;
                for (int l = 0; l < lanes; ++l) fresh[at + l] -= f->value[r] * by[l];
            }
        }
    }
}

/* Lane l of fresh -= dphi D phi' + phi D dphi', for a change of phi. */
static void change_fresh(double *fresh, int l, int lanes, const transition_t *f, int na,
                         const double *change, const double *D, int nr, double *across)
{
    for (int i = 0; i < nr; ++i) {
        int any = 0;
        for (int j = 0; j < nr; ++j) across[j] = 0.0;
        for (int c = 0; c < nr; ++c)
            if (change[(size_t)i * nr + c] != 0.0 && ++any)
                for (int j = 0; j < nr; ++j)
                    across[j] += change[(size_t)i * nr + c] * D[(size_t)c * nr + j];
        for (int j = 0; j < (any ? nr : 0); ++j) {
            double *to = fresh + (size_t)PAIR(i, j, nr) * lanes + l;
            for (int r = f->first[na + j]; r < f->first[na + j + 1]; ++r)
                *to -= (i == j ? 2.0 : 1.0) * f->value[r] * across[f->index[r] - na];
        }
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
    const size_t size = na + nr, rows = size + more, stride = round4((int)size), lanes = round4(nl);
    const size_t width = stride + round4(nx) + lanes, wide = round4(nx + nl + 1);
    return 4 + rows * (2 * width + stride) + rows * size * (lanes + 4) + width + 2 * stride +
           round4(nr * nr) + (size_t)nr * nr * lanes + round4(nr * ((int)lanes + 1)) +
           round4((na + more) * (na + nq + more) + STATES * nr) + (2 * NY + 1 + lanes + wide) * wide;
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
 * there are nd; white (NY) variances; ncol, c_output (ncol);
 * nr random components: disturbances, colours, then further states of disturbances; stationary
 * (nr x nr) their covariance; which (n - 1 x 2) of the transitions are those of the steps after
 * each sample, of all but the last and of this one, towards a step of perhaps another length;
 * memory (n_transitions x nr x nr) these; of nl levels, in `lanes`, nl rounded up to whole vectors,
 * d_white (NY x lanes) and d_stationary (nr x nr x lanes) are the derivatives; nm of them, l_moving
 * (nm), change the transitions by d_memory (n_transitions x nm x nr x nr);
 * measured (n x NY), NaN where missing; beyond (n x NY) the largest e^2/S with which a sample moves
 * anything, NULL for any.
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
                  const int *q_column, const double *white, int ncol, const int *c_output, int nr,
                  const double *stationary, const int *which, const double *memory,
                  int nl, const double *d_white, const double *d_stationary, int nm,
                  const int *l_moving, const double *d_memory, const double *measured,
                  const double *beyond, double *gram_out, double *level_out, double *e_out, double *s_out,
                  double *rows_out, double *path_out, double *gains_out, double *moves_out, double *total,
                  double *work)
{
    const int m = na + nq, tail = m + ncol, size = na + nr, n_rows = size + more;
    const int stride = round4(size), lanes = round4(nl), c_levels = stride + round4(nx);
    const int joint = c_levels + lanes, width = nx + nl + 1, wide = round4(width);
    const size_t block_moves = (size_t)(size + nq) * size, four_levels = (size_t)n_rows * size;
    /* No vector across two lines of the cache, from which it would be read twice. */
    work += (4 - (size_t)work / sizeof(double) % 4) % 4;
    double *J = work, *Jnext = J + (size_t)n_rows * joint;
    double *across = Jnext + (size_t)n_rows * joint;
    four_t *dP = (four_t *)(across + (size_t)n_rows * stride), *dPacross = dP + lanes / 4 * four_levels;
    double *c = (double *)(dPacross + four_levels), *delta = c + joint, *mean = delta + stride;
    double *fresh = mean + stride, *d_fresh = fresh + round4(nr * nr);
    double *lanes_across = d_fresh + (size_t)nr * nr * lanes;
    double *entries = lanes_across + round4(nr * (lanes + 1));
    double *rows = entries + round4((na + more) * (m + more) + STATES * nr);
    double *rowsq = rows + (size_t)NY * wide, *slope = rowsq + (size_t)NY * wide;
    double *information = slope + wide, *gram = information + (size_t)lanes * wide;
    int place[NZ + PROCESSES * NF], sensors_remember = 0, last = -1;
    const size_t square = (size_t)nr * nr;
    const int c_passing = c_disturbance + nd;
    transition_t f = {.size = size, .rows = n_rows, .value = entries};
    sparse_t h;
    double z[MAX1(NZ)], seen[MAX1(NZ)], y[MAX1(NY)], p[MAX1(NP)];
    SCRATCH row_t s[MAX1(NZ)], sy[MAX1(NY)];
    double sum_log = 0.0, sum_square = 0.0, product_s = 1.0;
    const columns_t chosen = {c_passing + more, round4(c_passing + more), columns};
    memset(work, 0, sizeof(double) * (size_t)(gram + (size_t)wide * wide - work));
    memcpy(z, z0, sizeof(double) * NZ);
    memcpy(p, p0, sizeof(double) * NP);
    let_act(p, nq, q_index, mean + na);
    for (int l = 0; l < m + more; ++l)
        place[l] = l < na ? l : l < m ? c_disturbance + q_column[l - na] : c_passing + l - m;
    for (int i = 0; i < na + more; ++i)
        memcpy(J + (size_t)(i < na ? i : i + nr) * joint + stride, x0 + (size_t)i * nx, sizeof(double) * nx);
    for (int i = 0; i < nr; ++i)
        memcpy(J + (size_t)(na + i) * joint + na, stationary + (size_t)i * nr, sizeof(double) * nr);
    add_random(dP, four_levels, d_stationary, na, nr, size, lanes);
    for (int i = 0; i < na; ++i) sensors_remember |= uncertain[i] >= NX + NA;
    for (int k = 0; k < n; ++k) {
        const double *input = inputs + (size_t)k * NU;
        const double since = step_before(times, n, k, h_sub, h_max);
        double check = 0.0;
        for (int i = 0; i < NZ; ++i) check += z[i];
        if (!(fabs(check) < DIVERGED)) return k;
        memcpy(seen, z, sizeof z);
        if (moves_out)
            for (int j = 0; j < nq; ++j)
                memcpy(moves_out + (size_t)k * block_moves + (size_t)(size + j) * size,
                       J + (size_t)(na + j) * joint, sizeof(double) * size);
        clear_rows(s, NZ, &chosen);
        for (int i = 0; i < na + more; ++i) s[uncertain[i]][i < na ? i : c_passing + i - na] = 1.0;
        sample_step(seen, s, input, p, times[k], since, y, sy, &chosen);
        for (int i = 0; i < stride; ++i) delta[i] = 0.0;
        int n_seen = 0;
        for (int i = 0; i < NY; ++i) {
            const double value = measured[(size_t)k * NY + i];
            int missing = isnan(value);
            double *row = rows + (size_t)n_seen * wide, *q = rowsq + (size_t)n_seen * wide;
            if (e_out) e_out[(size_t)k * NY + i] = NAN;
            if (missing && !s_out && !rows_out) continue;
            double e = missing ? 0.0 : value - y[i];
            h.n = 0;
            for (int j = 0; j < m; ++j) keep_entry(&h, j, sy[i][place[j]]);
            for (int j = 0; j < ncol; ++j)
                if (c_output[j] == i) {
                    keep_entry(&h, m + j, 1.0);
                    e -= mean[m + j];
                }
            e -= dot_sparse(&h, delta);
            for (int j = 0; j < joint; ++j) c[j] = 0.0;
            for (int r = 0; r < h.n; ++r) axpy(c, h.value[r], J + (size_t)h.index[r] * joint, joint);
            for (int j = 0; j < more; ++j)
                if (sy[i][c_passing + j] != 0.0)
                    axpy(c, sy[i][c_passing + j], J + (size_t)(size + j) * joint, joint);
            for (int j = 0; j < np; ++j) c[stride + nx - np + j] += sy[i][c_parameter + j];
            const double *g = c; /* P h comes first */
            const double explained = dot_sparse(&h, g), S = explained + white[i];
            if (!(S > 0.0) || !isfinite(e)) return k;
            const double inverse = 1.0 / S, root = sqrt(inverse);
            if (e_out && !missing) e_out[(size_t)k * NY + i] = e;
            if (s_out) s_out[(size_t)k * NY + i] = S;
            if (beyond) missing |= e * e * inverse > beyond[(size_t)k * NY + i];
            if (gains_out) {
                double *kept = gains_out + ((size_t)k * NY + i) * 2 * size;
                for (int r = 0; r < h.n; ++r) kept[h.index[r]] = h.value[r];
                for (int j = 0; j < size; ++j) kept[size + j] = g[j] * inverse;
            }
            for (int j = 0; j < nx; j += 4)
                *(four_t *)(row + j) = -root * *(const four_t *)(c + stride + j);
            for (int l = 0; l < nl; ++l) row[nx + l] = -root * c[c_levels + l];
            row[nx + nl] = root * e;
            if (!missing)
                for (int r = 0; r < size; ++r) axpy(J + (size_t)r * joint, -g[r] * inverse, c, joint);
            for (int l = 0; l < lanes; l += 4) {
                *(four_t *)(q + l) = *(const four_t *)(d_white + (size_t)i * lanes + l);
                measure_levels(dP + l / 4 * four_levels, J + c_levels + l, joint, q + l, &h, g, e,
                               inverse, !missing, explained != 0.0, size);
            }
            if (rows_out) {
                double *target = rows_out + ((size_t)k * NY + i) * (nx + 2 * nl);
                memcpy(target, row, sizeof(double) * (nx + nl));
                if (!missing) memcpy(target + nx + nl, q, sizeof(double) * nl);
            }
            if (missing) continue; /* moves nothing */
            ++n_seen;
            axpy(delta, e * inverse, g, size);
            const double misfit = e * e * inverse;
            axpy(slope, 0.5 * (1.0 - misfit), q, nl);
            /* One logarithm for many variances. */
            product_s *= S;
            if (product_s < 1e-200 || product_s > 1e200) {
                sum_log += log(product_s);
                product_s = 1.0;
            }
            sum_square += misfit;
        }
        add_products(gram, rows, n_seen, wide, width);
        add_products(information, rowsq, n_seen, wide, nl);
        for (int i = 0; i < na; ++i) z[uncertain[i]] += delta[i];
        for (int i = na; i < size; ++i) mean[i] += delta[i];
        if (path_out) {
            double *path = path_out + (size_t)k * (NZ + nq + ncol);
            memcpy(path, z, sizeof(double) * NZ);
            for (int i = na; i < tail; ++i) path[NZ + i - na] = mean[i];
        }
        if (k + 1 >= n) break;
        /* Towards the next sample, in steps over which the disturbances are held. */
        const int steps = parts_of_interval(times[k + 1] - times[k], h_sub);
        const double within = step_before(times, n, k + 1, h_sub, h_max);
        for (int step = 0; step < steps; ++step) {
            const int now = which[2 * k + (step + 1 == steps)];
            const double *phi = memory + now * square, *d_phi = d_memory + now * nm * square;
            double inner_times[2], inner_inputs[2 * MAX1(NU)];
            part_of_interval(times + k, input, step, steps, inner_times, inner_inputs);
            let_act(p, nq, q_index, mean + na);
            clear_rows(s, NZ, &chosen);
            for (int i = 0; i < na + more; ++i)
                s[uncertain[i]][i < na ? i : c_passing + i - na] = 1.0;
            /* Sensor memory moves on with what is known after the measurement. */
            if (sensors_remember)
                sample_step(z, s, inner_inputs, p, inner_times[0], step ? within : since, y, sy,
                            &chosen);
            else if (step == 0) /* that of sensors without an error, which nothing reads */
                memcpy(z + NX + NA, seen + NX + NA, sizeof(double) * NS);
            advance_interval(z, s, inner_times, inner_inputs, p, h_max, 0, sensors_remember, &chosen);
            keep_transition(&f, (const row_t *)s, uncertain, place, phi, na, nq, nr);
            if (now != last) {
                last = now;
                fresh_noise(fresh, &f, na, stationary, nr, 1, lanes_across);
                fresh_noise(d_fresh, &f, na, d_stationary, nr, lanes, lanes_across);
                for (int l = 0; l < nm; ++l)
                    change_fresh(d_fresh, l_moving[l], lanes, &f, na, d_phi + l * square, stationary, nr,
                                 lanes_across);
            }
            if (moves_out) keep_move(moves_out + (size_t)k * block_moves, &f, step, across, Jnext);
            moved(Jnext, joint, &f, n_rows, J, joint);
            double *before = J;
            J = Jnext;
            Jnext = before;
            for (int i = 0; i < na + more; ++i) {
                double *row = J + (size_t)(i < na ? i : i + nr) * joint;
                for (int j = 0; j < np; ++j) row[stride + nx - np + j] += s[uncertain[i]][c_parameter + j];
                if (i >= na) memset(row, 0, sizeof(double) * stride); /* is certain */
            }
            for (int l = 0; l < lanes / 4; ++l) moved_levels(dP + l * four_levels, &f, dPacross);
            add_random(dP, four_levels, d_fresh, na, nr, size, lanes);
            for (int l = 0; l < nm; ++l)
                add_changed_memory(dP + l_moving[l] / 4 * four_levels, J + c_levels, l_moving[l], na, nr,
                                   size, d_phi + l * square, J, joint, mean);
            /* P = F (F P)' + Q. */
            for (int i = 0; i < size; ++i)
                for (int j = 0; j < size; ++j) across[(size_t)j * stride + i] = J[(size_t)i * joint + j];
            moved(J, joint, &f, size, across, stride);
            for (int i = 0; i < nr; ++i)
                for (int j = 0; j < nr; ++j)
                    J[(size_t)(na + i) * joint + na + j] += fresh[PAIR(i, j, nr)];
            /* Measurements correct the symmetric part alone: what rounding leaves of another would
             * grow with the square of an unstable mode. */
            for (int i = 0; i < size; ++i)
                for (int j = 0; j < i; ++j) J[(size_t)j * joint + i] = J[(size_t)i * joint + j];
            remember(mean + na, phi, nr, delta);
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
        const double since = step_before(times, n, k, h_sub, h_max);
        double check = 0.0;
        for (int i = 0; i < NZ; ++i) check += z[i];
        if (!(fabs(check) < DIVERGED)) return k;
        memcpy(seen, z, sizeof z);
        sample_step(seen, NULL, input, p, times[k], since, y, NULL, NULL);
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
        const int steps = parts_of_interval(times[k + 1] - times[k], h_sub);
        const double within = step_before(times, n, k + 1, h_sub, h_max);
        for (int step = 0; step < steps; ++step) {
            double inner_times[2], inner_inputs[2 * MAX1(NU)];
            part_of_interval(times + k, input, step, steps, inner_times, inner_inputs);
            let_act(p, nq, q_index, mean + na);
            if (NS > 0)
                sample_step(z, NULL, inner_inputs, p, inner_times[0], step ? within : since, y,
                            NULL, NULL);
            advance_interval(z, NULL, inner_times, inner_inputs, p, h_max, 0, NS > 0, NULL);
            const int now = which[2 * k + (step + 1 == steps)];
            remember(mean + na, memory + (size_t)now * nr * nr, nr, delta);
        }
        let_act(p, nq, q_index, mean + na);
    }
    return -1;
}
