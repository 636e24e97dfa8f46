/* Solve a (n x n, row by row) x = b by elimination with pivots; b becomes x. */
static void solve(double *a, double *b)
{
    for (int k = 0; k < NX; ++k) {
        int pivot = k;
        for (int i = k + 1; i < NX; ++i)
            if (fabs(a[i * NX + k]) > fabs(a[pivot * NX + k])) pivot = i;
        for (int j = 0; j < NX; ++j) {
            const double swap = a[k * NX + j];
            a[k * NX + j] = a[pivot * NX + j];
            a[pivot * NX + j] = swap;
        }
        const double swap = b[k];
        b[k] = b[pivot];
        b[pivot] = swap;
        for (int i = k + 1; i < NX; ++i) {
            const double factor = a[i * NX + k] / a[k * NX + k];
            for (int j = k; j < NX; ++j) a[i * NX + j] -= factor * a[k * NX + j];
            b[i] -= factor * b[k];
        }
    }
    for (int i = NX - 1; i >= 0; --i) {
        for (int j = i + 1; j < NX; ++j) b[i] -= a[i * NX + j] * b[j];
        b[i] /= a[i * NX + i];
    }
}

/* x = base + h gamma rates(x) by Newton's method; NaN where it does not arrive. */
static void solve_stage(double *x, const double *base, const double *d, const double *p, double t,
                        double hg)
{
    double k[MAX1(NX)], matrix[MAX1(NX * NX)], step[MAX1(NX)];
    for (int iteration = 0; iteration < 40; ++iteration) {
        int arrived = 1;
        rates(x, d, p, t, k);
        slopes(x, d, p, t, matrix);
        for (int i = 0; i < NX; ++i) {
            for (int j = 0; j < NX; ++j) matrix[i * NX + j] = (i == j) - hg * matrix[i * NX + j];
            step[i] = base[i] + hg * k[i] - x[i];
        }
        solve(matrix, step);
        for (int i = 0; i < NX; ++i) {
            const double size = fmax(fmax(fabs(x[i]), fabs(base[i])), fabs(hg * k[i]));
            if (!(fabs(step[i]) <= 1e-9 * size + 1e-15)) arrived = 0;
            x[i] += step[i];
        }
        if (arrived) return;
    }
    for (int i = 0; i < NX; ++i) x[i] = NAN;
}

/* One step of the L-stable method of three implicit stages (Alexander 1977). */
static void one_step(double *z, const double *from, const double *to, const double *p, double t,
                     double h)
{
    const double gamma = $gamma, fractions[] = {gamma, (1.0 + gamma) / 2.0, 1.0};
    const double weights[] = {$weights};
    double u[MAX1(NU)], d[MAX1(ND)], next[MAX1(NA)], other[MAX1(NA)];
    double k[3][MAX1(NX)], x[MAX1(NX)], base[MAX1(NX)];
    memcpy(x, z, sizeof(double) * NX);
    for (int stage = 0; stage < 3; ++stage) {
        between(from, to, fractions[stage], u);
        actuate(z + NX, u, p, t, h, d, other);
        for (int i = 0; i < NX; ++i) {
            base[i] = z[i];
            for (int l = 0; l < stage; ++l) base[i] += h * weights[3 * stage + l] * k[l][i];
        }
        solve_stage(x, base, d, p, t + fractions[stage] * h, h * gamma);
        for (int i = 0; i < NX; ++i) k[stage][i] = (x[i] - base[i]) / (h * gamma);
    }
    between(from, to, 0.5, u);
    actuate(z + NX, u, p, t, h, d, next);
    memcpy(z, x, sizeof(double) * NX);
    for (int i = 0; i < NA; ++i) z[NX + i] = next[i];
}
