/* The unscented Kalman filter of observers/ukf.py in plain scalar C, to measure its speed against. */
#include <math.h>

#define PI 3.141592653589793
#define TAU 6.283185307179586
#define SLIP_MAX (PI / 9.0)
#define FAR 1e8
#define V_MAX 70.0
#define A_MAX 100.0
#define LEAST 1e-6
#define MOST 1e6
#define V_START 10.0
#define A_START 3.0
#define BETA_START 0.1
#define PSI_START 1.0
#define PSI_KNOWN 0.5
#define GATE 2.0
#define LONGEST 60.0
#define LOST 3.0
#define STATES 27

static const double WIDEST[6] = {1e6, 1e6, V_MAX * V_MAX, 1e3, 3.0, 0.04};
static const double NODE[3] = {0.1127016653792583, 0.5, 0.8872983346207417};
static const double WEIGHT[3] = {5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0};

typedef struct { double x, y, xx, xy, yy, heading, heading_variance, length, width; } Measurement;
typedef struct { double x, y, xx, xy, yy; } Innovation;
typedef struct {
    double noise, jerk, slip, yaw, huber, heading, heading_noise, l_r, coast, reverse, alpha, beta, kappa, mean;
} Gains;
typedef double Mean[6];
typedef double Matrix[6][6];

static double wrap(double angle) { return angle - TAU * floor(angle / TAU + 0.5); }
static double larger(double a, double b) { return b > a ? b : a; }
static double smaller(double a, double b) { return b < a ? b : a; }
static double within(double v, double limit) { return v > limit ? limit : v < -limit ? -limit : v; }
static int seen(const Measurement *y) { return fabs(y->x) < FAR && fabs(y->y) < FAR; }

static int pointed(const Measurement *y) {
    return fabs(y->heading) < FAR && 0.0 <= y->heading_variance && y->heading_variance < INFINITY;
}

static int directed(double dx, double dy, const Measurement *y0, const Measurement *y1, double noise) {
    double d2 = dx * dx + dy * dy;
    double across = (y0->xx + y1->xx) * dy * dy - 2.0 * (y0->xy + y1->xy) * dx * dy + (y0->yy + y1->yy) * dx * dx;
    return d2 * d2 > GATE * GATE * larger(across, 2.0 * (noise * noise) * d2) && d2 > 0.0;
}

static void scatter(const Measurement *y, const Gains *g, double *xx, double *xy, double *yy) {
    double a = y->xx > 0.0 ? smaller(y->xx, MOST) : 0.0, b = y->yy > 0.0 ? smaller(y->yy, MOST) : 0.0;
    double least = larger(g->noise * g->noise, LEAST);
    *xy = fabs(y->xy) < INFINITY ? within(y->xy, sqrt(a * b)) : 0.0;
    *xx = a + least;
    *yy = b + least;
}

static double heading_scatter(const Measurement *y, const Gains *g) {
    return smaller(y->heading_variance, MOST) + larger(g->heading_noise * g->heading_noise, LEAST);
}

static inline void mirror(Matrix P) {
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < i; j++) P[j][i] = P[i][j];
}

/* ---------------------------------------------------------------- beginning */

static void begin_moving(Mean x, Matrix P, const Measurement *y0, const Measurement *y1, double dt, int told,
                         const Gains *g) {
    double dx = y1->x - y0->x, dy = y1->y - y0->y, d = hypot(dx, dy);
    int clear = directed(dx, dy, y0, y1, g->noise);
    if (clear && !told) x[4] = atan2(dy, dx);
    double c = cos(x[4]), s = sin(x[4]), xx = P[0][0], xy = P[1][0], yy = P[1][1], xx0, xy0, yy0;
    scatter(y0, g, &xx0, &xy0, &yy0);
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

static void begin(Mean x, Matrix P, const Measurement *y0, const Measurement *y1, double dt, const Gains *g) {
    const Measurement *y = seen(y1) ? y1 : y0, *h = pointed(y1) ? y1 : y0;
    int told = g->heading > 0.0 && pointed(h);
    x[0] = y->x;
    x[1] = y->y;
    scatter(y, g, &P[0][0], &P[1][0], &P[1][1]);
    P[2][2] = V_START * V_START;
    P[3][3] = A_START * A_START;
    P[4][4] = PSI_START * PSI_START;
    P[5][5] = BETA_START * BETA_START;
    if (told) {
        x[4] = wrap(h->heading);
        P[4][4] = smaller(heading_scatter(h, g), PSI_START * PSI_START);
    }
    if (seen(y0) && seen(y1) && 0.0 < dt && dt < INFINITY)
        begin_moving(x, P, y0, y1, larger(dt, 1e-6), told, g);
    mirror(P);
}

/* ---------------------------------------------------------------- prediction */

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

static void along(double t, const Gains *g, double w[6]) {
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

static void disturb(Matrix P, double t, double V, double twist, double c, double s, const Gains *g) {
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
    mirror(P);
}

static double travel(double *V, double *A, double t, double T) {
    double v0 = *V, a0 = *A, a, v, d;
    fade(t, T, &a, &v, &d);
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

static int cholesky(Matrix P, Matrix L) {
    for (int i = 0; i < 6; i++)
        for (int j = 0; j <= i; j++) {
            double total = P[i][j];
            for (int k = 0; k < j; k++) total -= L[i][k] * L[j][k];
            if (i > j) L[i][j] = total / L[j][j];
            else if (total > 0.0) L[i][i] = sqrt(total);
            else return 0;
        }
    return 1;
}

static void points(Matrix P, Matrix L) {
    Matrix M;
    for (int i = 0; i < 4; i++)
        for (int j = 0; j <= i; j++) M[i][j] = P[i + 2][j + 2];
    for (int i = 0; i < 2; i++) {
        for (int j = 0; j < 4; j++) M[i + 4][j] = P[i][j + 2];
        for (int j = 0; j <= i; j++) M[i + 4][j + 4] = P[i][j];
    }
    for (double more = 1e-12; !cholesky(M, L) && more < 1e12; more *= 100.0)
        for (int i = 0; i < 6; i++) M[i][i] += more * (1.0 + M[i][i]);
}

static inline void arc(double psi, double beta, double way, double l_r, double *dx, double *dy, double *turn) {
    double half = 0.5 * way * sin(beta) / l_r;
    double chord = way * (fabs(half) > 1e-4 ? sin(half) / half : 1.0 - half * half / 6.0), chi = psi + beta + half;
    *dx = chord * cos(chi);
    *dy = chord * sin(chi);
    *turn = 2.0 * half;
}

static inline void sum(Matrix P, Matrix L, double D[8][6], Mean b, double w, double bb) {
    for (int i = 0; i < 6; i++)
        for (int j = 0; j <= i; j++) {
            double total = 0.0;
            for (int k = 0; k < 8; k++) total += D[k][i] * D[k][j];
            P[i][j] = w * total + bb * b[i] * b[j];
        }
    P[0][0] += L[4][4] * L[4][4];
    P[1][0] += L[5][4] * L[4][4];
    P[1][1] += L[5][4] * L[5][4] + L[5][5] * L[5][5];
}

static inline void advance(Mean x, Matrix P, double dt, const Gains *g) {
    double D[8][6], a, v, s, dx, dy, turn;
    Mean b = {0.0};
    Matrix L = {{0.0}};
    points(P, L);
    double t = smaller(dt, LONGEST), out = g->alpha * g->alpha * (6.0 + g->kappa), w = 0.5 / out, r = sqrt(out);
    fade(t, g->coast, &a, &v, &s);
    double V = x[2], A = x[3], psi = x[4], beta = x[5], way = travel(&x[2], &x[3], t, g->coast);
    arc(psi, beta, way, g->l_r, &dx, &dy, &turn);
    for (int k = 0; k < 8; k++) {
        int i = k < 4 ? k : k - 4;
        double h = k < 4 ? r : -r, ux, uy, u;
        double dV = h * L[0][i], dA = h * L[1][i], dpsi = h * L[2][i], dbeta = h * L[3][i];
        arc(psi + dpsi, beta + dbeta, way + dV * t + dA * s, g->l_r, &ux, &uy, &u);
        D[k][0] = h * L[4][i] + (ux - dx);
        D[k][1] = h * L[5][i] + (uy - dy);
        D[k][2] = dV + dA * v;
        D[k][3] = dA * a;
        D[k][4] = dpsi + (u - turn);
        D[k][5] = dbeta;
        for (int j = 0; j < 6; j++) b[j] += w * D[k][j];
    }
    double m = g->mean > 0.0 ? 1.0 : 0.0;
    sum(P, L, D, b, w, m * (g->beta - g->alpha * g->alpha));
    x[0] += dx + m * b[0];
    x[1] += dy + m * b[1];
    x[4] = wrap(psi + turn + m * b[4]);
    double chi = psi + beta + 0.5 * turn;
    disturb(P, t, V + 0.5 * A * v, cos(beta) / g->l_r, cos(chi), sin(chi), g);
}

/* ---------------------------------------------------------------- correction */

static double huber(const Innovation *i, double k) {
    double determinant = i->xx * i->yy - i->xy * i->xy;
    if (!(k > 0.0 && determinant > 0.0)) return 1.0;
    double square = (i->yy * i->x * i->x - 2.0 * i->xy * i->x * i->y + i->xx * i->y * i->y) / determinant;
    return square <= k * k ? 1.0 : k / sqrt(square);
}

static inline void correct_two(Mean x, Matrix P, const Innovation *e, double w) {
    double l = 1.0 / sqrt(e->xx / w), m = e->xy / w * l, k = 1.0 / sqrt(e->yy / w - m * m), a = e->x * l;
    double b = (e->y - m * a) * k, G[6][2];
    for (int i = 0; i < 6; i++) {
        G[i][0] = P[i][0] * l;
        G[i][1] = (P[i][1] - m * G[i][0]) * k;
    }
    for (int i = 0; i < 6; i++) {
        x[i] += G[i][0] * a + G[i][1] * b;
        for (int j = 0; j <= i; j++) {
            P[i][j] -= G[i][0] * G[j][0] + G[i][1] * G[j][1];
            P[j][i] = P[i][j];
        }
    }
}

static inline void correct_one(Mean x, Matrix P, int at, double e, double r) {
    double p = P[at][at], q = 1.0 / (P[at][at] + r);
    for (int i = 0; i < 6; i++) {
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
    for (int i = 0; i < 6; i++) {
        P[i][at] *= r * q;
        P[at][i] = P[i][at];
    }
}

static void aim(Mean x, Matrix P, double course) {
    x[4] = course - x[5];
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < i; j++)
            if ((i >= 2 && j < 2) || i == 4 || j == 4) P[i][j] = P[j][i] = 0.0;
    P[4][4] = PSI_KNOWN * PSI_KNOWN;
}

static void turn_round(Mean x, Matrix P) {
    x[4] += 2.0 * x[5] + PI;
    for (int i = 0; i < 6; i++) P[4][i] += 2.0 * P[5][i];
    for (int i = 0; i < 6; i++) P[i][4] += 2.0 * P[i][5];
    for (int i = 0; i < 6; i++) {
        if (i != 2 && i != 3 && i <= 4) continue;
        x[i] = -x[i];
        for (int j = 0; j < 6; j++) {
            P[i][j] = -P[i][j];
            P[j][i] = -P[j][i];
        }
    }
}

static inline void correct(Mean x, Matrix P, const Measurement *y, const Gains *g) {
    double xx, xy, yy;
    scatter(y, g, &xx, &xy, &yy);
    Innovation i = {y->x - x[0], y->y - x[1], P[0][0] + xx, P[1][0] + xy, P[1][1] + yy};
    double far = (i.yy * i.x * i.x - 2.0 * i.xy * i.x * i.y + i.xx * i.y * i.y) / (i.xx * i.yy - i.xy * i.xy);
    if (far > LOST * LOST && P[4][4] > PSI_KNOWN * PSI_KNOWN && x[2] * x[2] < P[2][2]) aim(x, P, atan2(i.y, i.x));
    correct_two(x, P, &i, huber(&i, g->huber));
    if (g->heading > 0.0 && pointed(y)) {
        double e = wrap(y->heading - x[4]), r = heading_scatter(y, g), s = P[4][4] + r;
        if (g->huber > 0.0 && e * e > g->huber * g->huber * s) r = sqrt(s) * fabs(e) / g->huber - P[4][4];
        correct_one(x, P, 4, e, r);
    } else if (x[2] < -g->reverse) {
        turn_round(x, P);
    }
}

static inline void bound(Mean x, Matrix P) {
    x[2] = within(x[2], V_MAX);
    x[3] = within(x[3], A_MAX);
    x[4] = wrap(x[4]);
    x[5] = within(x[5], SLIP_MAX);
    for (int i = 0; i < 6; i++) {
        if (!(P[i][i] > WIDEST[i])) continue;
        double shrink = sqrt(WIDEST[i] / P[i][i]);
        for (int j = 0; j < 6; j++) {
            P[j][i] *= shrink;
            P[i][j] *= shrink;
        }
    }
}

/* ---------------------------------------------------------------- drivers */

static inline void load(const double *row, Mean x, Matrix P) {
    for (int i = 0; i < 6; i++) x[i] = row[i];
    for (int i = 0, k = 6; i < 6; i++)
        for (int j = 0; j <= i; j++, k++) P[i][j] = P[j][i] = row[k];
}

static inline void store(Mean x, Matrix P, double *row) {
    for (int i = 0; i < 6; i++) row[i] = x[i];
    for (int i = 0, k = 6; i < 6; i++)
        for (int j = 0; j <= i; j++, k++) row[k] = P[i][j];
}

static void start(const Measurement *y0, const Measurement *y1, double dt, const Gains *g, double *row) {
    Mean x = {0.0};
    Matrix P = {{0.0}};
    begin(x, P, y0, y1, dt, g);
    bound(x, P);
    store(x, P, row);
}

static void step(const double *now, const Measurement *y, double dt, const Gains *g, double *row) {
    if (!(0.0 < dt && dt < INFINITY)) {
        for (int i = 0; i < STATES; i++) row[i] = now[i];
        return;
    }
    Mean x;
    Matrix P;
    load(now, x, P);
    advance(x, P, dt, g);
    if (seen(y)) correct(x, P, y, g);
    bound(x, P);
    store(x, P, row);
}

void run(const double *y, const double *dt, const double *gains, double *out, long n, long T) {
    const Gains *g = (const Gains *)gains;
    for (long i = 0; i < n; i++) {
        const Measurement *m = (const Measurement *)(y + i * T * 9);
        double *rows = out + i * T * STATES;
        int started = 0;
        for (long k = 0; k < T * STATES; k++) rows[k] = NAN;
        for (long k = 1; k < T; k++) {
            double h = dt[i * T + k], *row = rows + k * STATES;
            if (started) {
                step(row - STATES, m + k, h, g, row);
            } else if (m[k - 1].x + m[k - 1].y + m[k].x + m[k].y == m[k - 1].x + m[k - 1].y + m[k].x + m[k].y) {
                start(m + k - 1, m + k, h, g, row);
                started = 1;
            }
        }
    }
}
