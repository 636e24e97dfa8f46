/* One step of the classical Runge-Kutta method. */
static void one_step(double *z, const double *from, const double *to, const double *p, double t,
                     double h)
{
    double u[MAX1(NU)], d0[MAX1(ND)], dm[MAX1(ND)], d1[MAX1(ND)], next[MAX1(NA)], other[MAX1(NA)];
    double k1[MAX1(NX)], k2[MAX1(NX)], k3[MAX1(NX)], k4[MAX1(NX)], x[MAX1(NX)];
    const double *first = d0, *middle = d0, *last = d0;
    between(from, to, 0.0, u);
    actuate(z + NX, u, p, t, h, d0, next);
    if (ANY_LINEAR) {
        between(from, to, 0.5, u);
        actuate(z + NX, u, p, t, h, dm, next);
        between(from, to, 1.0, u);
        actuate(z + NX, u, p, t, h, d1, other);
        middle = dm;
        last = d1;
    }
    rates(z, first, p, t, k1);
    for (int i = 0; i < NX; ++i) x[i] = z[i] + 0.5 * h * k1[i];
    rates(x, middle, p, t + 0.5 * h, k2);
    for (int i = 0; i < NX; ++i) x[i] = z[i] + 0.5 * h * k2[i];
    rates(x, middle, p, t + 0.5 * h, k3);
    for (int i = 0; i < NX; ++i) x[i] = z[i] + h * k3[i];
    rates(x, last, p, t + h, k4);
    for (int i = 0; i < NX; ++i) z[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    for (int i = 0; i < NA; ++i) z[NX + i] = next[i];
    (void)other;
}
