/* The extended Kalman filter of observers/ekf.py in plain scalar C, to measure its speed against. */
#define SIZE 8
#include "common.h"

#define REACH 3.0

typedef struct {
    Bicycle car;
    double hop, hop_threshold, hop_time;
} Gains;

/* ---------------------------------------------------------------- prediction */

/* Lower half of P <- F P F'; of F, what is neither 0 nor 1. */
static inline void carry(Matrix F, Matrix P, int n) {
    for (int j = 0; j < n; j++) {
        P[0][j] += F[0][2] * P[2][j] + F[0][3] * P[3][j] + F[0][4] * P[4][j] + F[0][5] * P[5][j];
        P[1][j] += F[1][2] * P[2][j] + F[1][3] * P[3][j] + F[1][4] * P[4][j] + F[1][5] * P[5][j];
        P[4][j] += F[4][2] * P[2][j] + F[4][3] * P[3][j] + F[4][5] * P[5][j];
        P[2][j] += F[2][3] * P[3][j];
        for (int i = 6; i < n; i++) P[i][j] *= F[i][i];
        P[3][j] *= F[3][3];
    }
    for (int i = 0; i < n; i++) {
        P[i][0] += F[0][2] * P[i][2] + F[0][3] * P[i][3] + F[0][4] * P[i][4] + F[0][5] * P[i][5];
        P[i][1] += F[1][2] * P[i][2] + F[1][3] * P[i][3] + F[1][4] * P[i][4] + F[1][5] * P[i][5];
        P[i][4] += F[4][2] * P[i][2] + F[4][3] * P[i][3] + F[4][5] * P[i][5];
        P[i][2] += F[2][3] * P[i][3];
        for (int j = 6; j < n; j++) P[i][j] *= F[j][j];
        P[i][3] *= F[3][3];
    }
}

static inline void advance(Mean x, Matrix P, int n, double dt, const Gains *g) {
    double t = smaller(dt, LONGEST), V = x[2], A = x[3], psi = x[4], beta = x[5], a, v, d;
    fade(t, g->car.coast, &a, &v, &d);
    double way = travel(&x[2], &x[3], t, g->car.coast, a, v, d);
    double bend = sin(beta) / g->car.l_r, twist = cos(beta) / g->car.l_r, half = 0.5 * way * bend;
    double ch = cos(half), sh = sin(half), cm = cos(psi + beta + half), sm = sin(psi + beta + half);
    double c1 = cm * ch - sm * sh, s1 = sm * ch + cm * sh, q = half * half, sinc, slope;
    if (fabs(half) < 1e-2) {
        sinc = 1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0));
        slope = -half / 3.0 * (1.0 - q / 10.0 * (1.0 - q / 28.0));
    } else {
        sinc = sh / half;
        slope = (ch - sh / half) / half;
    }
    double dx = way * sinc * cm, dy = way * sinc * sm, k = 0.5 * way * way * twist;
    x[0] += dx;
    x[1] += dy;
    x[4] = wrap(psi + 2.0 * half);
    Matrix F;
    identity(F, n);
    F[0][2] = t * c1;
    F[0][3] = d * c1;
    F[0][4] = -dy;
    F[0][5] = k * (slope * cm - sinc * sm) - dy;
    F[1][2] = t * s1;
    F[1][3] = d * s1;
    F[1][4] = dx;
    F[1][5] = k * (slope * sm + sinc * cm) + dx;
    F[2][3] = v;
    F[3][3] = a;
    F[4][2] = t * bend;
    F[4][3] = d * bend;
    F[4][5] = way * twist;
    for (int i = 6; i < n; i++) {
        F[i][i] = exp(-t / g->hop_time);
        x[i] *= F[i][i];
    }
    carry(F, P, n);
    disturb(P, n, t, V + 0.5 * A * v, twist, cm, sm, &g->car);
}

/* ---------------------------------------------------------------- correction */

static inline Innovation innovation(Mean x, Matrix P, Columns G, int n, const Measurement *y, const Gains *g) {
    if (n == 6) return against(x, P, G, n, y, g->car.noise);
    double xx, xy, yy;
    scatter(y, g->car.noise, &xx, &xy, &yy);
    double c = cos(x[4]), s = sin(x[4]), dx = c * x[6] - s * x[7], dy = s * x[6] + c * x[7];
    for (int i = 0; i < n; i++) {
        G[i][0] = P[i][0] + (-dy * P[i][4] + c * P[i][6] - s * P[i][7]);
        G[i][1] = P[i][1] + (dx * P[i][4] + s * P[i][6] + c * P[i][7]);
    }
    xx += G[0][0] - dy * G[4][0] + c * G[6][0] - s * G[7][0];
    xy += G[0][1] - dy * G[4][1] + c * G[6][1] - s * G[7][1];
    yy += G[1][1] + dx * G[4][1] + s * G[6][1] + c * G[7][1];
    Innovation e = {y->x - x[0] - dx, y->y - x[1] - dy, xx, xy, yy};
    return e;
}

static void draw(Mean x, Matrix P, const Gains *g) {
    for (int i = 6; i < 8; i++) {
        x[i] = 0.0;
        for (int j = 0; j < 8; j++) P[i][j] = P[j][i] = 0.0;
        P[i][i] = g->hop * g->hop;
    }
}

static inline void correct(Mean x, Matrix P, int n, const Measurement *y, const Gains *g) {
    Columns G;
    Innovation i = innovation(x, P, G, n, y, g);
    if (n > 6 && normalised(&i) > g->hop_threshold * g->hop_threshold) {
        draw(x, P, g);
        i = innovation(x, P, G, n, y, g);
    }
    if (lost(x, P, &i)) {
        aim(x, P, n, atan2(i.y, i.x));
        i = innovation(x, P, G, n, y, g);
    }
    correct_all(x, P, G, n, &i, y, &g->car);
    for (int k = 6; k < n; k++) x[k] = clip(x[k], REACH * g->hop);
}

/* ---------------------------------------------------------------- drivers */

static void start(const Measurement *y0, const Measurement *y1, double dt, const Gains *g, double *row) {
    Mean x = {0.0};
    Matrix P = {{0.0}};
    begin(x, P, y0, y1, dt, &g->car);
    if (g->hop > 0.0) {
        double h = g->hop * g->hop, c = cos(x[4]), s = sin(x[4]);
        P[0][0] += h;
        P[1][1] += h;
        P[6][6] = P[7][7] = h;
        P[6][0] = P[7][1] = -c * h;
        P[6][1] = -s * h;
        P[7][0] = s * h;
        mirror(P, 8);
    }
    store(x, P, 8, row);
}

static inline void step_of(const double *now, const Measurement *y, double dt, const Gains *g, double *row, int n) {
    if (!(0.0 < dt && dt < INFINITY)) {
        for (int i = 0; i < STATES; i++) row[i] = now[i];
        return;
    }
    Mean x;
    Matrix P;
    load(now, x, P, n);
    advance(x, P, n, dt, g);
    if (seen(y)) correct(x, P, n, y, g);
    store(x, P, n, row);
}

RUN(start(&m[k - 1], &m[k], h, g, s[k]),
    g->hop > 0.0 ? step_of(s[k - 1], &m[k], h, g, s[k], 8) : step_of(s[k - 1], &m[k], h, g, s[k], 6))
