/* Extended Kalman filter of a sampled model, with exact tangents along its own path.
 *
 * Included after trajectory.c, compiled with SELECT. Of the full state, na components are
 * uncertain ("uncertain"); behind them stand nq first-order Gauss-Markov disturbances, each a
 * parameter of the model that is held over a step, and ncol coloured sensor errors. With
 *
 *   x- = F(x+), P- = F P F' + Q;  S = h'P h + r, g = P h, x+ = x- + g e/S, P+ = P - g g'/S
 *
 * one output at a time, columns X hold the derivatives of x by start states and parameters at
 * frozen gain, and every level of the noise carries the tangents (dm, dP) of mean and covariance.
 *
 * Rows of X, P and dP have a stride of whole vectors.
 */

static inline int round4(int n) { return (n + 3) & ~3; }

/* Four numbers at a time; every array below is padded to whole vectors. */
typedef double four_t __attribute__((vector_size(32), aligned(8)));

/* target += factor * source, over n numbers rounded up to whole vectors. */
static inline void axpy(double *restrict target, double factor, const double *restrict source, int n)
{
    for (int j = 0; j < n; j += 4) *(four_t *)(target + j) += factor * *(const four_t *)(source + j);
}

static inline double dot(const double *restrict a, const double *restrict b, int n)
{
    double sum = 0.0;
    for (int j = 0; j < n; ++j) sum += a[j] * b[j];
    return sum;
}

/* A row of measurement derivatives is mostly zero: its other entries, n of them. */
typedef struct {
    int n;
    int index[NZ + NF + NY + 1];
    double value[NZ + NF + NY + 1];
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

/* target <- F source F' for symmetric source; all n x n with stride; product is scratch.
 * F = [A G; 0 phi]: ag holds [A G] by rows (na x m), turned its transpose (m x wide rows). */
static void sandwich(double *restrict target, const double *restrict source,
                     const double *restrict ag, const double *restrict turned,
                     const double *restrict phi, int na, int m, int n, int stride,
                     double *restrict product)
{
    const int narrow = round4(na);
    for (int i = 0; i < na; ++i) {
        double *row = product + (size_t)i * stride;
        for (int j = 0; j < stride; ++j) row[j] = 0.0;
        for (int l = 0; l < m; ++l) {
            const double v = ag[(size_t)i * m + l];
            if (v != 0.0) axpy(row, v, source + (size_t)l * stride, stride);
        }
    }
    for (int i = na; i < n; ++i)
        for (int j = 0; j < stride; ++j)
            product[(size_t)i * stride + j] = phi[i] * source[(size_t)i * stride + j];
    for (int i = 0; i < n; ++i) {
        const double *from = product + (size_t)i * stride;
        double *row = target + (size_t)i * stride;
        for (int j = 0; j < stride; ++j) row[j] = 0.0;
        for (int l = 0; l < m; ++l) axpy(row, from[l], turned + (size_t)l * narrow, narrow);
        for (int j = na; j < n; ++j) row[j] = from[j] * phi[j];
    }
}

enum { FORCE_VARIANCE, FORCE_TIME, WHITE_VARIANCE, COLOUR_VARIANCE, COLOUR_TIME };

/* Doubles of scratch that kernel_filter needs. */
size_t kernel_filter_work(int na, int nq, int ncol, int nx, int nl)
{
    const size_t n = na + nq + ncol, stride = round4((int)n), wide = round4(nx + nl + 1);
    return n * stride * (3 + (size_t)nl) + 2 * n * round4(nx) + (size_t)nl * 3 * stride + 8 * stride +
           (size_t)round4(na) * 2 * (na + nq) + 2 * wide + wide * wide + 64;
}

/* Filter one record.
 *
 * n, times, inputs, p0, h_max as of kernel_run; h_sub, longest step of the noise;
 * z0 (NZ); na, uncertain (na), positions of the uncertain components of the full state;
 * nx columns of X of which the last np are parameters; in the rows of sensitivities those stand
 * from c_parameter, disturbances from c_disturbance; columns (NF) maps
 * each free parameter to its place in these rows or to -1; x0 (na x nx) start of X;
 * nq, q_index (nq) positions of the disturbances in p, q_variance, q_time (nq);
 * white (NY) variances; ncol, c_output (ncol), c_variance, c_time (ncol);
 * measured (n x NY), NaN where missing; nl, l_kind, l_index (nl), -1 for the time of all.
 * Results, each but gram may be NULL: gram ((nx + nl + 1)^2) the sum of [de e]'[de e]/S; level
 * (nl + nl^2) half gradient sum q(1 - e^2/S)/2 and sum q q'/2 of the levels, q = d log S;
 * e, s (n x NY) innovations, NaN where missing, and their variances; rows (n x NY x (nx + 2 nl)) of
 * de/sqrt(S), then q of the levels, missing samples included; path (n x (NZ + nq + ncol)) filtered means; total (2) sums of log S and e^2/S.
 * Returns -1, or the first sample at which something is not finite or S is not positive.
 */
int kernel_filter(int n, const double *times, const double *inputs, const double *p0, double h_max,
                  double h_sub, const double *z0, int na, const int *uncertain, int nx, int np,
                  int c_parameter, int c_disturbance, const int *columns, const double *x0, int nq, const int *q_index,
                  const double *q_variance, const double *q_time, const double *white, int ncol,
                  const int *c_output, const double *c_variance, const double *c_time,
                  const double *measured, int nl, const int *l_kind, const int *l_index,
                  double *gram_out, double *level_out, double *e_out, double *s_out,
                  double *rows_out, double *path_out, double *total, double *work)
{
    const int m = na + nq, size = m + ncol, stride = round4(size), sx = round4(nx);
    const int width = nx + nl + 1, wide = round4(width);
    const size_t block = (size_t)size * stride;
    double *P = work, *product = P + block, *swap = product + block;
    double *dP = swap + (block > (size_t)size * sx ? block : (size_t)size * sx);
    double *X = dP + block * nl, *dm = X + (size_t)size * sx, *dg = dm + (size_t)nl * stride;
    double *dnext = dg + (size_t)nl * stride, *h = dnext + (size_t)nl * stride, *g = h + stride;
    double *delta = g + stride, *mean = delta + stride, *phi = mean + stride, *dphi = phi + stride;
    double *column = dphi + stride, *spare = column + stride, *ag = spare + stride;
    double *turned = ag + (size_t)na * m, *row = turned + (size_t)round4(na) * m, *rowq = row + wide, *gram = rowq + wide;
    double z[MAX1(NZ)], seen[MAX1(NZ)], y[MAX1(NY)], p[MAX1(NP)];
    SCRATCH row_t s[MAX1(NZ)], sy[MAX1(NY)];
    sparse_t hs;
    double sum_log = 0.0, sum_square = 0.0, product_s = 1.0, last_length = -1.0;
    active_width(c_disturbance + nq);
    column_of = columns;
    memset(work, 0, sizeof(double) * (size_t)(gram - work));
    memset(gram, 0, sizeof(double) * (size_t)wide * wide);
    memcpy(z, z0, sizeof(double) * NZ);
    memcpy(p, p0, sizeof(double) * NP);
    for (int j = 0; j < nq; ++j) p[q_index[j]] = 0.0;
    for (int i = 0; i < na; ++i)
        for (int j = 0; j < nx; ++j) X[(size_t)i * sx + j] = x0[(size_t)i * nx + j];
    for (int j = 0; j < nq; ++j) P[(size_t)(na + j) * (stride + 1)] = q_variance[j];
    for (int j = 0; j < ncol; ++j) P[(size_t)(m + j) * (stride + 1)] = c_variance[j];
    for (int l = 0; l < nl; ++l) {
        if (l_kind[l] == FORCE_VARIANCE) dP[block * l + (size_t)(na + l_index[l]) * (stride + 1)] = 1.0;
        if (l_kind[l] == COLOUR_VARIANCE) dP[block * l + (size_t)(m + l_index[l]) * (stride + 1)] = 1.0;
    }
    if (level_out) memset(level_out, 0, sizeof(double) * (size_t)nl * (nl + 1));
    for (int k = 0; k < n; ++k) {
        const double *input = inputs + (size_t)k * NU;
        const double since = k > 0 ? times[k] - times[k - 1] : (n > 1 ? times[1] - times[0] : 1.0);
        double check = 0.0;
        for (int i = 0; i < NZ; ++i) check += z[i];
        if (!isfinite(check)) return k;
        memcpy(seen, z, sizeof z);
        for (int i = 0; i < NZ; ++i)
            for (int j = 0; j < ACTIVE; ++j) s[i][j] = 0.0;
        for (int i = 0; i < na; ++i) s[uncertain[i]][i] = 1.0;
        sample_step(seen, s, input, p, times[k], since, y, sy, 1);
        for (int i = 0; i < size; ++i) delta[i] = 0.0;
        for (int i = 0; i < NY; ++i) {
            const double value = measured[(size_t)k * NY + i];
            const int missing = isnan(value);
            if (e_out) e_out[(size_t)k * NY + i] = NAN;
            if (missing && !s_out && !rows_out) continue;
            double e = missing ? 0.0 : value - y[i];
            for (int j = 0; j < stride; ++j) h[j] = 0.0;
            for (int j = 0; j < na; ++j) h[j] = sy[i][j];
            for (int j = 0; j < nq; ++j) h[na + j] = sy[i][c_disturbance + j];
            for (int j = 0; j < ncol; ++j)
                if (c_output[j] == i) {
                    h[m + j] = 1.0;
                    e -= mean[m + j];
                }
            hs.n = 0;
            for (int r = 0; r < size; ++r)
                if (h[r] != 0.0) {
                    hs.index[hs.n] = r;
                    hs.value[hs.n++] = h[r];
                }
            e -= dot_sparse(&hs, delta);
            times_sparse(g, P, &hs, stride);
            const double S = dot_sparse(&hs, g) + white[i];
            if (!(S > 0.0) || !isfinite(e)) return k;
            const double inverse = 1.0 / S, root = sqrt(inverse);
            for (int j = 0; j < wide; ++j) row[j] = 0.0;
            for (int j = 0; j < np; ++j) row[nx - np + j] = -sy[i][c_parameter + j];
            for (int r = 0; r < hs.n; ++r) axpy(row, -hs.value[r], X + (size_t)hs.index[r] * sx, nx);
            if (s_out) s_out[(size_t)k * NY + i] = S;
            if (missing) {
                if (rows_out) {
                    double *target = rows_out + ((size_t)k * NY + i) * (nx + 2 * nl);
                    for (int j = 0; j < nx; ++j) target[j] = root * row[j];
                    for (int l = 0; l < nl; ++l)
                        target[nx + l] = -root * dot_sparse(&hs, dm + (size_t)l * stride);
                }
                continue;
            }
            for (int r = 0; r < size; ++r) axpy(X + (size_t)r * sx, g[r] * inverse, row, nx);
            for (int l = 0; l < nl; ++l) {
                double *d = dP + block * l, *mu = dm + (size_t)l * stride, *v = dg + (size_t)l * stride;
                times_sparse(v, d, &hs, stride);
                double dS = dot_sparse(&hs, v);
                if (l_kind[l] == WHITE_VARIANCE && l_index[l] == i) dS += 1.0;
                const double de = -dot_sparse(&hs, mu), q = dS * inverse;
                row[nx + l] = de;
                rowq[l] = q;
                for (int j = 0; j < size; ++j)
                    mu[j] += ((v[j] - g[j] * q) * e + g[j] * de) * inverse;
                for (int r = 0; r < size; ++r) {
                    const double b = g[r] * inverse, a = v[r] * inverse - b * q;
                    double *restrict line = d + (size_t)r * stride;
                    for (int j = 0; j < stride; j += 4)
                        *(four_t *)(line + j) -= a * *(four_t *)(g + j) + b * *(four_t *)(v + j);
                }
            }
            for (int r = 0; r < size; ++r) axpy(P + (size_t)r * stride, -g[r] * inverse, g, stride);
            axpy(delta, e * inverse, g, size);
            row[nx + nl] = e;
            for (int a = 0; a < width; ++a) row[a] *= root;
            /* Lower triangle, whole vectors. */
            for (int a = 0; a < width; ++a)
                if (row[a] != 0.0) axpy(gram + (size_t)a * wide, row[a], row, (a + 4) & ~3);
            if (rows_out) {
                double *target = rows_out + ((size_t)k * NY + i) * (nx + 2 * nl);
                memcpy(target, row, sizeof(double) * (nx + nl));
                memcpy(target + nx + nl, rowq, sizeof(double) * nl);
            }
            const double square = e * e * inverse;
            if (level_out)
                for (int l = 0; l < nl; ++l) {
                    level_out[l] += 0.5 * rowq[l] * (1.0 - square);
                    for (int j = 0; j < nl; ++j) level_out[nl + (size_t)l * nl + j] += 0.5 * rowq[l] * rowq[j];
                }
            /* One logarithm for many variances. */
            product_s *= S;
            if (product_s < 1e-200 || product_s > 1e200) {
                sum_log += log(product_s);
                product_s = 1.0;
            }
            sum_square += square;
            if (e_out) e_out[(size_t)k * NY + i] = e;
        }
        for (int i = 0; i < na; ++i) z[uncertain[i]] += delta[i];
        for (int i = na; i < size; ++i) mean[i] += delta[i];
        if (path_out) {
            double *path = path_out + (size_t)k * (NZ + nq + ncol);
            memcpy(path, z, sizeof(double) * NZ);
            for (int i = na; i < size; ++i) path[NZ + i - na] = mean[i];
        }
        if (k + 1 >= n) break;
        /* Towards the next sample, in steps over which the disturbances are held. */
        const double interval = times[k + 1] - times[k];
        int steps = (int)ceil(interval / h_sub - 1e-6);
        if (steps < 1) steps = 1;
        for (int step = 0; step < steps; ++step) {
            const double from = (double)step / steps, to = (double)(step + 1) / steps;
            double inner_times[2] = {times[k] + from * interval, times[k] + to * interval};
            double inner_inputs[2 * MAX1(NU)];
            inputs_between(input, input + NU, from, inner_inputs);
            inputs_between(input, input + NU, step + 1 == steps ? 1.0 : to, inner_inputs + NU);
            for (int j = 0; j < nq; ++j) p[q_index[j]] = mean[na + j];
            for (int i = 0; i < NZ; ++i)
                for (int j = 0; j < ACTIVE; ++j) s[i][j] = 0.0;
            for (int i = 0; i < na; ++i) s[uncertain[i]][i] = 1.0;
            /* Sensor memory moves on with what is known after the measurement. */
            if (NS > 0 && step == 0) sample_step(z, s, input, p, times[k], since, y, sy, 1);
            advance_interval(z, s, inner_times, inner_inputs, p, h_max, 0, 1);
            for (int i = 0; i < na; ++i) {
                const double *line = s[uncertain[i]];
                memcpy(ag + (size_t)i * m, line, sizeof(double) * na);
                memcpy(ag + (size_t)i * m + na, line + c_disturbance, sizeof(double) * nq);
            }
            for (int i = 0; i < na; ++i)
                for (int l = 0; l < m; ++l) turned[(size_t)l * round4(na) + i] = ag[(size_t)i * m + l];
            const double length = inner_times[1] - inner_times[0];
            if (fabs(length - last_length) > 1e-12 * length) {
                last_length = length;
                for (int i = na; i < size; ++i) {
                    const double time = i < m ? q_time[i - na] : c_time[i - m];
                    phi[i] = exp(-length / time);
                    dphi[i] = phi[i] * length / time;
                }
            }
            /* Columns; swap holds them meanwhile. */
            for (int i = 0; i < na; ++i) {
                const double *line = s[uncertain[i]];
                double *value = swap + (size_t)i * sx;
                for (int j = 0; j < sx; ++j) value[j] = 0.0;
                for (int j = 0; j < np; ++j) value[nx - np + j] = line[c_parameter + j];
                for (int l = 0; l < m; ++l) {
                    const double v = ag[(size_t)i * m + l];
                    if (v != 0.0) axpy(value, v, X + (size_t)l * sx, sx);
                }
            }
            memcpy(X, swap, sizeof(double) * (size_t)na * sx);
            for (int i = na; i < size; ++i)
                for (int j = 0; j < nx; ++j) X[(size_t)i * sx + j] *= phi[i];
            for (int l = 0; l < nl; ++l) {
                double *mu = dm + (size_t)l * stride, *next = dnext + (size_t)l * stride;
                for (int i = 0; i < stride; ++i) next[i] = 0.0;
                for (int i = 0; i < m; ++i) axpy(next, mu[i], turned + (size_t)i * round4(na), na);
                for (int i = na; i < size; ++i) next[i] = phi[i] * mu[i];
                double *d = dP + block * l;
                sandwich(swap, d, ag, turned, phi, na, m, size, stride, product);
                memcpy(d, swap, sizeof(double) * block);
                const int of_force = l_kind[l] == FORCE_VARIANCE || l_kind[l] == FORCE_TIME;
                const int first = of_force ? na : m, count = of_force ? nq : ncol;
                if (l_kind[l] == FORCE_TIME || l_kind[l] == COLOUR_TIME) {
                    /* One time, or with index -1 that of all. */
                    const int from_j = first + (l_index[l] < 0 ? 0 : l_index[l]);
                    const int to_j = l_index[l] < 0 ? first + count : from_j + 1;
                    for (int j = from_j; j < to_j; ++j) {
                        const double variance = of_force ? q_variance[j - na] : c_variance[j - m];
                        next[j] += dphi[j] * mean[j];
                        /* Column j of F P, the covariance still being the one before the step. */
                        for (int i = 0; i < na; ++i)
                            column[i] = dot(ag + (size_t)i * m, P + (size_t)j * stride, m);
                        for (int i = na; i < size; ++i) column[i] = phi[i] * P[(size_t)i * stride + j];
                        for (int i = 0; i < size; ++i) {
                            d[(size_t)i * stride + j] += dphi[j] * column[i];
                            d[(size_t)j * stride + i] += dphi[j] * column[i];
                        }
                        d[(size_t)j * (stride + 1)] -= 2.0 * variance * phi[j] * dphi[j];
                    }
                } else if (l_kind[l] == FORCE_VARIANCE || l_kind[l] == COLOUR_VARIANCE) {
                    const int i = first + l_index[l];
                    d[(size_t)i * (stride + 1)] += 1.0 - phi[i] * phi[i];
                }
                memcpy(mu, next, sizeof(double) * stride);
            }
            sandwich(swap, P, ag, turned, phi, na, m, size, stride, product);
            memcpy(P, swap, sizeof(double) * block);
            for (int j = 0; j < nq; ++j)
                P[(size_t)(na + j) * (stride + 1)] += q_variance[j] * (1.0 - phi[na + j] * phi[na + j]);
            for (int j = 0; j < ncol; ++j)
                P[(size_t)(m + j) * (stride + 1)] += c_variance[j] * (1.0 - phi[m + j] * phi[m + j]);
            for (int i = na; i < size; ++i) mean[i] *= phi[i];
        }
        for (int j = 0; j < nq; ++j) p[q_index[j]] = mean[na + j];
    }
    for (int a = 0; a < width; ++a)
        for (int b = 0; b <= a; ++b)
            gram_out[(size_t)a * width + b] = gram_out[(size_t)b * width + a] = gram[(size_t)a * wide + b];
    if (total) {
        total[0] = sum_log + log(product_s);
        total[1] = sum_square;
    }
    return -1;
}
