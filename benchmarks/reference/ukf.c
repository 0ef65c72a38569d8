/* The unscented Kalman filter of observers/ukf.py in plain scalar C, to measure its speed against. */
#define SIZE 6
#include "common.h"

typedef struct {
    Bicycle car;
    double alpha, beta, kappa, mean;
} Gains;

/* ---------------------------------------------------------------- prediction */

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
    fade(t, g->car.coast, &a, &v, &s);
    double V = x[2], A = x[3], psi = x[4], beta = x[5], way = travel(&x[2], &x[3], t, g->car.coast, a, v, s);
    arc(psi, beta, way, g->car.l_r, &dx, &dy, &turn);
    for (int k = 0; k < 8; k++) {
        int i = k < 4 ? k : k - 4;
        double h = k < 4 ? r : -r, ux, uy, u;
        double dV = h * L[0][i], dA = h * L[1][i], dpsi = h * L[2][i], dbeta = h * L[3][i];
        arc(psi + dpsi, beta + dbeta, way + dV * t + dA * s, g->car.l_r, &ux, &uy, &u);
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
    disturb(P, 6, t, V + 0.5 * A * v, cos(beta) / g->car.l_r, cos(chi), sin(chi), &g->car);
}

/* ---------------------------------------------------------------- correction */

static inline void correct(Mean x, Matrix P, const Measurement *y, const Gains *g) {
    Columns G;
    Innovation i = against(x, P, G, 6, y, g->car.noise);
    if (lost(x, P, &i)) {
        aim(x, P, 6, atan2(i.y, i.x));
        i = against(x, P, G, 6, y, g->car.noise);
    }
    correct_all(x, P, G, 6, &i, y, &g->car);
}

/* ---------------------------------------------------------------- drivers */

static void start(const Measurement *y0, const Measurement *y1, double dt, const Gains *g, double *row) {
    Mean x = {0.0};
    Matrix P = {{0.0}};
    begin(x, P, y0, y1, dt, &g->car);
    store(x, P, 6, row);
}

static void step(const double *now, const Measurement *y, double dt, const Gains *g, double *row) {
    if (!(0.0 < dt && dt < INFINITY)) {
        for (int i = 0; i < STATES; i++) row[i] = now[i];
        return;
    }
    Mean x;
    Matrix P;
    load(now, x, P, 6);
    advance(x, P, dt, g);
    if (seen(y)) correct(x, P, y, g);
    store(x, P, 6, row);
}

RUN(start(&m[k - 1], &m[k], h, g, s[k]), step(s[k - 1], &m[k], h, g, s[k]))
