/* What the observers in C share. A filter sets SIZE, the most states it estimates, before it includes this. */
#include <math.h>

#define PI 3.141592653589793
#define TAU 6.283185307179586
#define FAR 1e8
#define V_MAX 70.0
#define A_MAX 100.0
#define GATE 2.0
#ifndef SLIP_MAX
#define SLIP_MAX (PI / 9.0)
#endif

typedef struct { double x, y, xx, xy, yy, heading, heading_variance, length, width; } Measurement;
typedef struct { double x, y, xx, xy, yy; } Innovation;

static inline double wrap(double angle) { return angle - TAU * floor(angle / TAU + 0.5); }
static inline double clip(double v, double limit) { return v > limit ? limit : v < -limit ? -limit : v; }
static inline double larger(double a, double b) { return b > a ? b : a; }
static inline double smaller(double a, double b) { return b < a ? b : a; }

static inline void unknown(double *row, unsigned long n) {
    for (unsigned long j = 0; j < n; j++) row[j] = NAN;
}

/* void run(y, dt, gains, out, n, T): n tracks of T samples. BEGIN and STEP fill s[k], a State, from the
   measurements m[k - 1] and m[k], the time h between them, the Gains *g and, in STEP, s[k - 1]. */
#define RUN(BEGIN, STEP)                                                                                       \
    void run(const double *y, const double *dt, const double *gains, double *out, long n, long T) {            \
        const Gains *g = (const Gains *)gains;                                                                 \
        for (long i = 0; i < n; i++) {                                                                         \
            const Measurement *m = (const Measurement *)y + i * T;                                             \
            State *s = (State *)out + i * T;                                                                   \
            int started = 0;                                                                                   \
            for (long k = 0; k < T; k++) {                                                                     \
                double h = dt[i * T + k], sum = k ? m[k - 1].x + m[k - 1].y + m[k].x + m[k].y : NAN;           \
                if (started) {                                                                                 \
                    STEP;                                                                                      \
                } else if (sum == sum) {                                                                       \
                    BEGIN;                                                                                     \
                    started = 1;                                                                               \
                } else {                                                                                       \
                    unknown((double *)&s[k], sizeof(State) / sizeof(double));                                  \
                }                                                                                              \
            }                                                                                                  \
        }                                                                                                      \
    }

/* ---------------------------------------------------------------- measurements */

static inline int seen(const Measurement *y) { return fabs(y->x) < FAR && fabs(y->y) < FAR; }

static inline int pointed(const Measurement *y) {
    return fabs(y->heading) < FAR && 0.0 <= y->heading_variance && y->heading_variance < INFINITY;
}

static inline double heading_or(const Measurement *y, double otherwise) {
    return pointed(y) ? wrap(y->heading) : otherwise;
}

/* Whether the way (dx, dy) from y0 to y1 is longer than `gate` of its standard deviations across. */
static inline int directed(double dx, double dy, const Measurement *y0, const Measurement *y1, double noise,
                           double gate) {
    double d2 = dx * dx + dy * dy;
    double across = (y0->xx + y1->xx) * dy * dy - 2.0 * (y0->xy + y1->xy) * dx * dy + (y0->yy + y1->yy) * dx * dx;
    return d2 * d2 > gate * gate * larger(across, 2.0 * (noise * noise) * d2) && d2 > 0.0;
}

/* Squared length of an innovation in standard deviations. */
static inline double normalised(const Innovation *e) {
    return (e->yy * e->x * e->x - 2.0 * e->xy * e->x * e->y + e->xx * e->y * e->y)
           / (e->xx * e->yy - e->xy * e->xy);
}

static inline double huber(const Innovation *e, double k) {
    if (!(k > 0.0 && e->xx * e->yy - e->xy * e->xy > 0.0)) return 1.0;
    double square = normalised(e);
    return square <= k * k ? 1.0 : k / sqrt(square);
}

/* ---------------------------------------------------------------- observers with constant gains */

#define GAP_MAX 5.0
#define WIDE_MAX 20.0
#define LEAST_DT 1e-9

typedef struct { double l1, l2, l3; } Chain;
typedef struct { double x, y, turn; } Chord;

static inline Chain chain_gains(double L1, double L2, double L3, double dt) {
    double d = larger(dt, LEAST_DT), m = L1 / 3.0, p = L2 - L1 * m, r = m * (2.0 * m * m - L2) + L3;
    double D = 0.25 * r * r + p * p * p / 27.0, q, total, product;
    if (D > 0.0) {
        double A = pow(0.5 * fabs(r) + sqrt(D), 1.0 / 3.0);
        if (r > 0.0) A = -A;
        double B = -p / (3.0 * A);
        q = -expm1((A + B - m) * d);
        double sigma = (-0.5 * (A + B) - m) * d, half = 0.25 * sqrt(3.0) * (A - B) * d;
        double turned = 2.0 * exp(sigma) * (sin(half) * sin(half));
        total = 2.0 * (turned - expm1(sigma));
        product = expm1(sigma) * expm1(sigma) + 2.0 * turned;
    } else {
        double R = sqrt(larger(-p / 3.0, 0.0));
        double third = R > 1e-60 ? acos(clip(-0.5 * r / (R * R * R), 1.0)) / 3.0 : 0.0;
        q = -expm1((2.0 * R * cos(third) - m) * d);
        double q2 = -expm1((2.0 * R * cos(third - 2.0 * PI / 3.0) - m) * d);
        double q3 = -expm1((2.0 * R * cos(third + 2.0 * PI / 3.0) - m) * d);
        total = q2 + q3;
        product = q2 * q3;
    }
    double e2 = q * total + product, e3 = q * product;
    Chain l = {q + total - e2 + e3, (e2 - 1.5 * e3) / d, e3 / (d * d)};
    return l;
}

/* Time until a vehicle that brakes with an acceleration fading in T stands still; infinite where it never does. */
static inline double stop_time(double V, double A, double T) {
    return V * A < 0.0 && -V / (A * T) < 1.0 ? -T * log1p(V / (A * T)) : INFINITY;
}

/* Way; speed and acceleration in place. */
static inline double coast(double *speed, double *acceleration, double dt, double T) {
    double V = *speed, A = *acceleration, t = smaller(dt, stop_time(V, A, T));
    double fade = -expm1(-t / T), way = V * t + A * T * (t - T * fade);
    *speed = t < dt ? 0.0 : V + A * T * fade;
    *acceleration = t < dt ? 0.0 : A * (1.0 - fade);
    return way;
}

/* Straight line under an arc that begins with course chi and turns by twice `half`. */
static inline Chord chord(double way, double chi, double half) {
    double length = way * (fabs(half) > 1e-6 ? sin(half) / half : 1.0 - half * half / 6.0);
    Chord c = {length * cos(chi + half), length * sin(chi + half), 2.0 * half};
    return c;
}

/* Innovation (dx, dy) of an estimate corrected by the share l1 of it, with its covariance. */
static inline Innovation widened(double dx, double dy, const Measurement *y, double l1, double noise) {
    double wide = 1.0 / larger(1.0 - l1, 1.0 / WIDE_MAX), least = noise * noise;
    Innovation e = {dx, dy, wide * (y->xx + least), wide * y->xy, wide * (y->yy + least)};
    return e;
}

/* Weight of an innovation; the run of limited ones in place. */
static inline double patient_huber(const Innovation *e, double limit, double *run) {
    double w = huber(e, *run > 0.0 ? limit * pow(2.0, *run < 30.0 ? *run : 30.0) : limit);
    *run = w < 1.0 ? *run + 1.0 : 0.0;
    return w;
}

static inline double heading_innovation(double psi, const Measurement *y, double noise, double k, double *trust) {
    double variance = noise * noise + y->heading_variance;
    *trust = variance > 0.0 ? noise * noise / variance : 1.0;
    return clip(wrap(y->heading - psi), k > 0.0 ? k * sqrt(variance) : PI);
}

/* ---------------------------------------------------------------- filters: means and covariances */

#ifdef SIZE

#define LEAST 1e-6
#define MOST 1e6
#define V_START 10.0
#define A_START 3.0
#define PSI_KNOWN 0.5
#define LONGEST 60.0

typedef double Mean[SIZE];
typedef double Matrix[SIZE][SIZE];
typedef double Columns[SIZE][2];

static inline void scatter(const Measurement *y, double noise, double *xx, double *xy, double *yy) {
    double a = y->xx > 0.0 ? smaller(y->xx, MOST) : 0.0, b = y->yy > 0.0 ? smaller(y->yy, MOST) : 0.0;
    double least = larger(noise * noise, LEAST);
    *xy = fabs(y->xy) < INFINITY ? clip(y->xy, sqrt(a * b)) : 0.0;
    *xx = a + least;
    *yy = b + least;
}

static inline double heading_scatter(const Measurement *y, double noise) {
    return smaller(y->heading_variance, MOST) + larger(noise * noise, LEAST);
}

static inline void mirror(Matrix P, int n) {
    for (int i = 0; i < n; i++)
        for (int j = 0; j < i; j++) P[j][i] = P[i][j];
}

static inline void identity(Matrix F, int n) {
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) F[i][j] = 0.0;
        F[i][i] = 1.0;
    }
}

/* Innovation of the position, x[0] and x[1]; G becomes its covariance with the states. */
static inline Innovation against(Mean x, Matrix P, Columns G, int n, const Measurement *y, double noise) {
    double xx, xy, yy;
    scatter(y, noise, &xx, &xy, &yy);
    for (int i = 0; i < n; i++) {
        G[i][0] = P[i][0];
        G[i][1] = P[i][1];
    }
    Innovation e = {y->x - x[0], y->y - x[1], P[0][0] + xx, P[1][0] + xy, P[1][1] + yy};
    return e;
}

/* Correction by an innovation of two numbers; G, its covariance with the states, is used up. */
static inline void correct_two(Mean x, Matrix P, Columns G, int n, const Innovation *e) {
    double l = 1.0 / sqrt(e->xx), m = e->xy * l, k = 1.0 / sqrt(e->yy - m * m), a = e->x * l, b = (e->y - m * a) * k;
    for (int i = 0; i < n; i++) {
        G[i][0] *= l;
        G[i][1] = (G[i][1] - m * G[i][0]) * k;
        x[i] += G[i][0] * a + G[i][1] * b;
        for (int j = 0; j <= i; j++) {
            P[i][j] -= G[i][0] * G[j][0] + G[i][1] * G[j][1];
            P[j][i] = P[i][j];
        }
    }
}

/* The first `count` variances kept below `widest`, correlations unchanged. */
static inline void shrink(Matrix P, int n, const double *widest, int count) {
    for (int i = 0; i < count; i++) {
        if (!(P[i][i] > widest[i])) continue;
        double by = sqrt(widest[i] / P[i][i]);
        for (int j = 0; j < n; j++) {
            P[j][i] *= by;
            P[i][j] *= by;
        }
    }
}

/* ---------------------------------------------------------------- filters of the bicycle: X, Y, V, A, psi, beta */

#if SIZE >= 6

#define BETA_START 0.1
#define PSI_START 1.0
#define LOST 3.0
#define STATES (SIZE + SIZE * (SIZE + 1) / 2)

static const double WIDEST[6] = {1e6, 1e6, V_MAX * V_MAX, 1e3, 3.0, 0.04};
static const double NODE[3] = {0.1127016653792583, 0.5, 0.8872983346207417};
static const double WEIGHT[3] = {5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0};

typedef struct { double noise, jerk, slip, yaw, huber, heading, heading_noise, l_r, coast, reverse; } Bicycle;
typedef double State[STATES];

static inline void begin_moving(Mean x, Matrix P, const Measurement *y0, const Measurement *y1, double dt, int told,
                                const Bicycle *g) {
    double dx = y1->x - y0->x, dy = y1->y - y0->y, d = hypot(dx, dy);
    int clear = directed(dx, dy, y0, y1, g->noise, GATE);
    if (clear && !told) x[4] = atan2(dy, dx);
    double c = cos(x[4]), s = sin(x[4]), xx = P[0][0], xy = P[1][0], yy = P[1][1], xx0, xy0, yy0;
    scatter(y0, g->noise, &xx0, &xy0, &yy0);
    double xx2 = xx + xx0, xy2 = xy + xy0, yy2 = yy + yy0, half = 0.5 * A_START * dt;
    P[2][2] = (xx2 * c * c + 2.0 * xy2 * c * s + yy2 * s * s) / (dt * dt) + half * half;
    P[2][0] = (xx * c + xy * s) / dt;
    P[2][1] = (xy * c + yy * s) / dt;
    P[3][2] = 0.5 * (A_START * A_START) * dt;
    if (clear || told) x[2] = (dx * c + dy * s) / dt;
    else P[2][2] += (d / dt) * (d / dt);
    if (clear && !told) {
        P[4][0] = (xy * c - xx * s) / d;
        P[4][1] = (yy * c - xy * s) / d;
        P[4][2] = ((yy2 - xx2) * c * s + xy2 * (c * c - s * s)) / (d * dt);
        P[4][4] = (xx2 * s * s - 2.0 * xy2 * c * s + yy2 * c * c) / (d * d) + BETA_START * BETA_START;
        P[5][4] = -(BETA_START * BETA_START);
    }
}

/* The first estimate, into zeros. */
static inline void begin(Mean x, Matrix P, const Measurement *y0, const Measurement *y1, double dt,
                         const Bicycle *g) {
    const Measurement *y = seen(y1) ? y1 : y0, *h = pointed(y1) ? y1 : y0;
    int told = g->heading > 0.0 && pointed(h);
    x[0] = y->x;
    x[1] = y->y;
    scatter(y, g->noise, &P[0][0], &P[1][0], &P[1][1]);
    P[2][2] = V_START * V_START;
    P[3][3] = A_START * A_START;
    P[4][4] = PSI_START * PSI_START;
    P[5][5] = BETA_START * BETA_START;
    if (told) {
        x[4] = wrap(h->heading);
        P[4][4] = smaller(heading_scatter(h, g->heading_noise), PSI_START * PSI_START);
    }
    if (seen(y0) && seen(y1) && 0.0 < dt && dt < INFINITY)
        begin_moving(x, P, y0, y1, larger(dt, 1e-6), told, g);
    mirror(P, SIZE);
}

/* What an acceleration that fades in T leaves of itself after t, adds to the speed and to the way. */
static inline void fade(double t, double T, double *a, double *v, double *d) {
    if (!(T > 0.0)) {
        *a = 1.0;
        *v = t;
        *d = 0.5 * t * t;
        return;
    }
    double r = t / T;
    *a = exp(-t / T);
    if (r < 0.01) {
        *v = t * (1.0 - r / 2.0 * (1.0 - r / 3.0 * (1.0 - r / 4.0)));
        *d = 0.5 * t * t * (1.0 - r / 3.0 * (1.0 - r / 4.0 * (1.0 - r / 5.0)));
        return;
    }
    *v = T * (1.0 - *a);
    *d = T * (t - *v);
}

/* Way in t, (a, v, d) faded over it; speed and acceleration in place. */
static inline double travel(double *V, double *A, double t, double T, double a, double v, double d) {
    double v0 = *V, a0 = *A;
    if (v0 * a0 < 0.0 && fabs(v0) <= fabs(a0) * v) { /* it stops */
        double t0 = T > 0.0 ? -T * log1p(v0 / (a0 * T)) : -v0 / a0;
        fade(t0, T, &a, &v, &d);
        *V = *A = 0.0;
        return v0 * t0 + a0 * d;
    }
    *V = v0 + a0 * v;
    *A = a0 * a;
    return v0 * t + a0 * d;
}

/* Covariance of way, speed and acceleration that jerk leaves after t. */
static inline void along(double t, const Bicycle *g, double w[6]) {
    double T = g->coast, q = g->jerk * g->jerk, a, v, d, vv = 0.0, dd = 0.0;
    fade(t, T, &a, &v, &d);
    if (t < 0.1 * T || !(T > 0.0)) {
        for (int i = 0; i < 3; i++) {
            double a1, v1, d1;
            fade(NODE[i] * t, T, &a1, &v1, &d1);
            vv += WEIGHT[i] * t * v1 * v1;
            dd += WEIGHT[i] * t * d1 * d1;
        }
    } else {
        vv = T * (d - 0.5 * v * v);
        dd = T * T * (t * t * t / 3.0 - 2.0 * (t * d - T * (0.5 * t * t - d)) + vv);
    }
    double aa = T > 0.0 ? 0.5 * T * (1.0 - a * a) : t;
    w[0] = q * dd;
    w[1] = 0.5 * q * d * d;
    w[2] = q * (d * v - vv);
    w[3] = q * vv;
    w[4] = 0.5 * q * v * v;
    w[5] = q * aa;
}

/* Noise of t added to the lower half of P, which is mirrored. */
static inline void disturb(Matrix P, int n, double t, double V, double twist, double c, double s,
                           const Bicycle *g) {
    double w[6];
    along(t, g, w);
    double q = t * (g->slip * g->slip), r = t * (g->yaw * g->yaw), B = V * twist * t, D = V * t;
    double nn = D * D * (q * (1.0 / 3.0 + B / 4.0 + B * B / 20.0) + r / 3.0);
    double n_psi = D * (q * B * (1.0 / 3.0 + B / 8.0) + 0.5 * r), n_beta = D * q * (0.5 + B / 6.0);
    P[0][0] += c * c * w[0] + s * s * nn;
    P[1][0] += c * s * (w[0] - nn);
    P[1][1] += s * s * w[0] + c * c * nn;
    P[2][0] += c * w[1];
    P[2][1] += s * w[1];
    P[2][2] += w[3];
    P[3][0] += c * w[2];
    P[3][1] += s * w[2];
    P[3][2] += w[4];
    P[3][3] += w[5];
    P[4][0] -= s * n_psi;
    P[4][1] += c * n_psi;
    P[4][4] += q * B * B / 3.0 + r;
    P[5][0] -= s * n_beta;
    P[5][1] += c * n_beta;
    P[5][4] += 0.5 * q * B;
    P[5][5] += q;
    mirror(P, n);
}

/* Whether the yaw was never known and the innovation is far too large. */
static inline int lost(Mean x, Matrix P, const Innovation *e) {
    return P[4][4] > PSI_KNOWN * PSI_KNOWN && x[2] * x[2] < P[2][2] && normalised(e) > LOST * LOST;
}

static inline void aim(Mean x, Matrix P, int n, double course) {
    x[4] = course - x[5];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < i; j++)
            if ((i >= 2 && j < 2) || i == 4 || j == 4) P[i][j] = P[j][i] = 0.0;
    P[4][4] = PSI_KNOWN * PSI_KNOWN;
}

static inline void turn_round(Mean x, Matrix P, int n) {
    x[4] += 2.0 * x[5] + PI;
    for (int i = 0; i < n; i++) P[4][i] += 2.0 * P[5][i];
    for (int i = 0; i < n; i++) P[i][4] += 2.0 * P[i][5];
    for (int i = 0; i < n; i++) {
        if (i != 2 && i != 3 && i <= 4) continue;
        x[i] = -x[i];
        for (int j = 0; j < n; j++) {
            P[i][j] = -P[i][j];
            P[j][i] = -P[j][i];
        }
    }
}

/* Correction by the innovation e, of variance r, of state `at`. */
static inline void correct_one(Mean x, Matrix P, int n, int at, double e, double r) {
    double p = P[at][at], q = 1.0 / (P[at][at] + r);
    for (int i = 0; i < n; i++) {
        if (i == at) continue;
        double k = P[i][at] * q;
        x[i] += k * e;
        for (int j = 0; j <= i; j++) {
            if (j == at) continue;
            double g = P[j][at] * q;
            P[i][j] += (p + r) * k * g - k * P[j][at] - g * P[i][at];
            P[j][i] = P[i][j];
        }
    }
    x[at] += p * q * e;
    for (int i = 0; i < n; i++) {
        P[i][at] *= r * q;
        P[at][i] = P[i][at];
    }
}

/* Correction by position and heading. */
static inline void correct_all(Mean x, Matrix P, Columns G, int n, const Innovation *i, const Measurement *y,
                               const Bicycle *g) {
    double w = huber(i, g->huber);
    Innovation heavy = {i->x, i->y, i->xx / w, i->xy / w, i->yy / w};
    correct_two(x, P, G, n, &heavy);
    if (g->heading > 0.0 && pointed(y)) {
        double e = wrap(y->heading - x[4]), r = heading_scatter(y, g->heading_noise), s = P[4][4] + r;
        if (g->huber > 0.0 && e * e > g->huber * g->huber * s) r = sqrt(s) * fabs(e) / g->huber - P[4][4];
        correct_one(x, P, n, 4, e, r);
    } else if (x[2] < -g->reverse) {
        turn_round(x, P, n);
    }
}

static inline void load(const double *row, Mean x, Matrix P, int n) {
    for (int i = 0; i < n; i++) x[i] = row[i];
    for (int i = 0, k = SIZE; i < n; i++)
        for (int j = 0; j <= i; j++, k++) P[i][j] = P[j][i] = row[k];
}

/* The estimate, kept within its limits, to a row. */
static inline void store(Mean x, Matrix P, int n, double *row) {
    x[2] = clip(x[2], V_MAX);
    x[3] = clip(x[3], A_MAX);
    x[4] = wrap(x[4]);
    x[5] = clip(x[5], SLIP_MAX);
    shrink(P, n, WIDEST, 6);
    int k = SIZE;
    for (int i = 0; i < SIZE; i++) row[i] = i < n ? x[i] : 0.0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++, k++) row[k] = P[i][j];
    for (; k < STATES; k++) row[k] = 0.0;
}

#endif
#endif
