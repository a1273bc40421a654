/* Flight of the sphere far from the chip, for the benchmark's lower bound: four states
 *
 *     p' = v,  v' = F(p, i) / m - g,  d' = (-v - d) / Tf,  I' = KI e,  e = setpoint - R - p
 *     i = clamp(KP e + I + KD d)
 *
 * by Radau IIA of order 5 (Hairer and Wanner, Solving ODEs II, IV.8) with the analytic Jacobian.
 * The force is a cubic spline in p for each power of i. A step ends where the clamp toggles or the
 * sphere comes down to `near`; both are located on the collocation polynomial.
 */
#include <math.h>
#include <string.h>

#define N 4
#define S 3

typedef struct {
    double mass, gravity, radius, kp, ki, kd, rolloff, limit, setpoint;
    double enabled, controlled, pulled; /* flags: 0 or 1 */
    int cells;
    const double *knots, *spline; /* spline[cell][power of s, highest first][power of i] */
} Law;

static void force(const Law *law, double p, double i, double *f, double *fp, double *fi)
{
    *f = *fp = *fi = 0.0;
    if (!law->pulled) return;
    double y = p + law->radius;
    int low = 0, high = law->cells;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (y >= law->knots[middle]) low = middle; else high = middle;
    }
    double s = y - law->knots[low], power[3] = {1.0, i, i * i}, value[3];
    const double *c = law->spline + 12 * low;
    for (int k = 0; k < 3; k++) {
        value[k] = ((c[k] * s + c[3 + k]) * s + c[6 + k]) * s + c[9 + k];
        *f += value[k] * power[k];
        *fp += ((3 * c[k] * s + 2 * c[3 + k]) * s + c[6 + k]) * power[k];
    }
    *fi = value[1] + 2 * i * value[2];
}

static double demand(const Law *law, const double *x)
{
    return law->kp * (law->setpoint - law->radius - x[0]) + x[3] + law->kd * x[2];
}

static double current(const Law *law, const double *x, int saturated)
{
    if (!law->enabled) return 0.0;
    return saturated ? saturated * law->limit : demand(law, x);
}

static void rates(const Law *law, const double *x, int saturated, double *r)
{
    double f, fp, fi;
    force(law, x[0], current(law, x, saturated), &f, &fp, &fi);
    r[0] = x[1];
    r[1] = f / law->mass - law->gravity;
    r[2] = law->controlled ? (-x[1] - x[2]) / law->rolloff : 0.0;
    r[3] = law->enabled && !saturated ? law->ki * (law->setpoint - law->radius - x[0]) : 0.0;
}

static void jacobian(const Law *law, const double *x, int saturated, double J[N][N])
{
    double f, fp, fi;
    int linear = law->enabled && !saturated;
    force(law, x[0], current(law, x, saturated), &f, &fp, &fi);
    memset(J, 0, sizeof(double) * N * N);
    J[0][1] = 1.0;
    J[1][0] = (fp - (linear ? fi * law->kp : 0.0)) / law->mass;
    J[1][2] = linear ? fi * law->kd / law->mass : 0.0;
    J[1][3] = linear ? fi / law->mass : 0.0;
    if (law->controlled) J[2][1] = J[2][2] = -1.0 / law->rolloff;
    if (linear) J[3][0] = -law->ki;
}

static int factor(double *a, int n, int *pivot)
{
    for (int k = 0; k < n; k++) {
        int best = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(a[i * n + k]) > fabs(a[best * n + k])) best = i;
        pivot[k] = best;
        if (a[best * n + k] == 0.0) return 0;
        if (best != k)
            for (int j = 0; j < n; j++) {
                double swap = a[k * n + j];
                a[k * n + j] = a[best * n + j];
                a[best * n + j] = swap;
            }
        for (int i = k + 1; i < n; i++) {
            double m = a[i * n + k] /= a[k * n + k];
            for (int j = k + 1; j < n; j++) a[i * n + j] -= m * a[k * n + j];
        }
    }
    return 1;
}

static void solve(const double *a, int n, const int *pivot, double *b)
{
    for (int k = 0; k < n; k++) {
        double swap = b[k];
        b[k] = b[pivot[k]];
        b[pivot[k]] = swap;
    }
    for (int i = 1; i < n; i++)
        for (int j = 0; j < i; j++) b[i] -= a[i * n + j] * b[j];
    for (int i = n - 1; i >= 0; i--) {
        for (int j = i + 1; j < n; j++) b[i] -= a[i * n + j] * b[j];
        b[i] /= a[i * n + i];
    }
}

/* Collocation polynomial through (0, x) and the stages x + z, at the share `at` of the step. */
static void between(const double *x, double z[S][N], const double *c, double at, double *out)
{
    for (int n = 0; n < N; n++) out[n] = x[n];
    for (int i = 0; i < S; i++) {
        double weight = at / c[i];
        for (int j = 0; j < S; j++)
            if (j != i) weight *= (at - c[j]) / (c[i] - c[j]);
        for (int n = 0; n < N; n++) out[n] += weight * z[i][n];
    }
}

/* The next mode if the state does not belong to the present one: -1, 0, 1, or 2 at `near`. */
static int leaves(const Law *law, const double *x, int saturated, double near)
{
    if (x[0] < near) return 2;
    if (!law->enabled) return saturated;
    double wanted = demand(law, x);
    if (wanted > law->limit) return 1;
    if (wanted < -law->limit) return -1;
    return 0;
}

/* Integrates x from *t to `end` or to `near`. `track` (room, 3) gets time, p, v of every stage.
 * Returns the points in `track`; *mode is 2 if `near` was met. Negative: failed. */
int flight(const Law *law, double *x, double *t, double end, double near, double rtol,
           const double *scale, int *mode, double *track, int room)
{
    const double r = sqrt(6.0), c[S] = {(4 - r) / 10, (4 + r) / 10, 1.0};
    const double A[S][S] = {
        {(88 - 7 * r) / 360, (296 - 169 * r) / 1800, (-2 + 3 * r) / 225},
        {(296 + 169 * r) / 1800, (88 + 7 * r) / 360, (-2 - 3 * r) / 225},
        {(16 - r) / 36, (16 + r) / 36, 1.0 / 9}};
    const double e[S] = {(-13 - 7 * r) / 3, (-13 + 7 * r) / 3, -1.0 / 3};
    const double real = 3 + pow(3.0, 2.0 / 3) - pow(3.0, 1.0 / 3);
    double h = fmin(1e-6, end - *t), largest = 0.0;
    int count = 0, saturated = *mode, before = 0;
    double old[S][N], old_h = 0.0, x_old[N];

    while (*t < end) {
        double J[N][N], r0[N], z[S][N], big[S * N * S * N], small[N * N];
        int pivot[S * N], spivot[N];
        if (count + S + 1 > room || h < 1e-18) return -1;
        if (*t + h > end || end - *t - h < 1e-3 * h) h = end - *t;
        jacobian(law, x, saturated, J);
        rates(law, x, saturated, r0);
        for (int i = 0; i < S; i++)
            for (int j = 0; j < S; j++)
                for (int n = 0; n < N; n++)
                    for (int k = 0; k < N; k++)
                        big[(i * N + n) * S * N + j * N + k] =
                            (i == j && n == k ? 1.0 : 0.0) - h * A[i][j] * J[n][k];
        for (int n = 0; n < N; n++)
            for (int k = 0; k < N; k++)
                small[n * N + k] = (n == k ? real / h : 0.0) - J[n][k];
        if (!factor(big, S * N, pivot) || !factor(small, N, spivot)) { h /= 4; continue; }
        for (int i = 0; i < S; i++) {
            if (before) { /* guess: the last step's polynomial goes on */
                double ahead[N];
                between(x_old, old, c, 1.0 + c[i] * h / old_h, ahead);
                for (int n = 0; n < N; n++) z[i][n] = ahead[n] - x[n];
            } else
                for (int n = 0; n < N; n++) z[i][n] = 0.0;
        }
        double change = 1.0;
        for (int iteration = 0; iteration < 10 && change > 1e-3; iteration++) {
            double k[S][N], right[S * N];
            for (int i = 0; i < S; i++) {
                double stage[N];
                for (int n = 0; n < N; n++) stage[n] = x[n] + z[i][n];
                rates(law, stage, saturated, k[i]);
            }
            change = 0.0;
            for (int i = 0; i < S; i++)
                for (int n = 0; n < N; n++) {
                    double sum = -z[i][n];
                    for (int j = 0; j < S; j++) sum += h * A[i][j] * k[j][n];
                    right[i * N + n] = sum;
                }
            solve(big, S * N, pivot, right);
            for (int i = 0; i < S; i++)
                for (int n = 0; n < N; n++) {
                    z[i][n] += right[i * N + n];
                    double size = fabs(right[i * N + n]) / (rtol * (scale[n] + fabs(x[n])));
                    if (size > change) change = size;
                }
        }
        if (change > 1e-3) { h /= 4; before = 0; continue; }
        double error[N];
        largest = 0.0;
        for (int n = 0; n < N; n++)
            error[n] = r0[n] + (z[0][n] * e[0] + z[1][n] * e[1] + z[2][n] * e[2]) / h;
        solve(small, N, spivot, error);
        for (int n = 0; n < N; n++) {
            double size = fabs(error[n]) / (rtol * (scale[n] + fabs(x[n])));
            if (size > largest) largest = size;
        }
        double grow = 0.9 * pow(fmax(largest, 1e-8), -0.25);
        if (largest > 1.0) { h *= fmax(0.2, grow); before = 0; continue; }

        double last[N];
        between(x, z, c, 1.0, last);
        int next = leaves(law, last, saturated, near);
        double share = 1.0;
        if (next != saturated) {
            double low = 0.0, high = 1.0;
            for (int k = 0; k < 60; k++) {
                double middle = 0.5 * (low + high), state[N];
                between(x, z, c, middle, state);
                if (leaves(law, state, saturated, near) == saturated) low = middle;
                else high = middle;
            }
            share = high;
            between(x, z, c, share, last);
            next = leaves(law, last, saturated, near);
        }
        for (int i = 0; i < S; i++) {
            double state[N];
            between(x, z, c, share * c[i], state);
            track[3 * count] = *t + share * c[i] * h;
            track[3 * count + 1] = state[0];
            track[3 * count + 2] = state[1];
            count++;
        }
        memcpy(x_old, x, sizeof x_old);
        memcpy(old, z, sizeof old);
        old_h = h;
        memcpy(x, last, sizeof last);
        *t = share == 1.0 && *t + h >= end ? end : *t + share * h;
        before = share == 1.0;
        if (next == 2) { *mode = 2; return count; }
        if (next != saturated) h = fmin(h, 1e-7); else h *= fmin(5.0, fmax(0.2, grow));
        saturated = next;
    }
    *mode = saturated;
    return count;
}
