/* The interacting multiple models of observers/imm.py in plain scalar C, to measure their speed against. */
#define SIZE 5
#include "common.h"

#define W_MAX 10.0
#define LEAP 0.2
#define DRIFT 0.1
#define FRESH 0.01
#define SLOWEST 0.01
#define STATES 39

static const double WIDEST[5] = {1e6, 1e6, V_MAX * V_MAX, V_MAX * V_MAX, 10.0};

typedef struct {
    double noise, straight, turning, turn_rate, turn, begin, end, huber, heading, heading_noise, l_r, settle, reverse;
} Gains;
typedef double State[STATES];

/* ---------------------------------------------------------------- the two motions */

static inline void carry(Matrix F, Matrix P) {
    for (int j = 0; j < 5; j++) {
        double u = P[2][j], v = P[3][j], w = P[4][j];
        P[0][j] += F[0][2] * u + F[0][3] * v + F[0][4] * w;
        P[1][j] += F[1][2] * u + F[1][3] * v + F[1][4] * w;
        P[2][j] = F[2][2] * u + F[2][3] * v + F[2][4] * w;
        P[3][j] = F[3][2] * u + F[3][3] * v + F[3][4] * w;
        P[4][j] = F[4][4] * w;
    }
    for (int i = 0; i < 5; i++) {
        double u = P[i][2], v = P[i][3], w = P[i][4];
        P[i][0] += F[0][2] * u + F[0][3] * v + F[0][4] * w;
        P[i][1] += F[1][2] * u + F[1][3] * v + F[1][4] * w;
        P[i][2] = F[2][2] * u + F[2][3] * v + F[2][4] * w;
        P[i][3] = F[3][2] * u + F[3][3] * v + F[3][4] * w;
        P[i][4] = F[4][4] * w;
    }
    mirror(P, 5);
}

static inline void disturb(Matrix P, double q, double pp, double pv, double aside, double vv) {
    for (int i = 0; i < 2; i++) {
        P[i][i] += q * pp;
        P[i + 2][i + 2] += q * vv;
        P[i][i + 2] += q * pv;
        P[i + 2][i] += q * pv;
    }
    P[0][3] += q * aside;
    P[3][0] += q * aside;
    P[1][2] -= q * aside;
    P[2][1] -= q * aside;
}

static inline void swerve(Matrix P, double q, double t, double ex, double ey, double fx, double fy) {
    double t2 = t * t, t3 = t2 * t, t4 = t2 * t2, t5 = t4 * t;
    double pp = q * t5 / 20.0, pv = q * t4 / 8.0, pw = q * t3 / 6.0, vv = q * t3 / 3.0, vw = q * t2 / 2.0, ww = q * t;
    P[0][0] += pp * ex * ex;
    P[1][0] += pp * ex * ey;
    P[1][1] += pp * ey * ey;
    P[2][0] += pv * ex * fx;
    P[2][1] += pv * ey * fx;
    P[2][2] += vv * fx * fx;
    P[3][0] += pv * ex * fy;
    P[3][1] += pv * ey * fy;
    P[3][2] += vv * fx * fy;
    P[3][3] += vv * fy * fy;
    P[4][0] += pw * ex;
    P[4][1] += pw * ey;
    P[4][2] += vw * fx;
    P[4][3] += vw * fy;
    P[4][4] += ww;
    mirror(P, 5);
}

static inline void go_straight(Mean x, Matrix P, double t, double q, double turn) {
    Matrix F;
    identity(F, 5);
    F[0][2] = F[1][3] = t;
    F[4][4] = 0.0;
    x[0] += t * x[2];
    x[1] += t * x[3];
    x[4] = 0.0;
    carry(F, P);
    disturb(P, q * q, t * t * t / 3.0, t * t / 2.0, 0.0, t);
    P[4][4] += turn * turn;
}

static inline void go_round(Mean x, Matrix P, double t, double q, double q_w) {
    double u = x[2], v = x[3], w = x[4], a = w * t, b = a * a, c = cos(a), s = sin(a), g, h, S_w, C_w;
    if (fabs(a) < 1e-2) {
        g = 0.5 - b / 24.0 * (1.0 - b / 30.0);
        h = 1.0 / 6.0 - b / 120.0 * (1.0 - b / 42.0);
        S_w = -a / 3.0 * (1.0 - b / 10.0 * (1.0 - b / 28.0));
        C_w = 0.5 - b / 8.0 * (1.0 - b / 18.0);
    } else {
        g = (1.0 - c) / b;
        h = (a - s) / (b * a);
        S_w = (c - s / a) / a;
        C_w = (s - (1.0 - c) / a) / a;
    }
    g *= t * t;
    h *= t * t * t;
    S_w *= t * t;
    C_w *= t * t;
    double S = t - w * w * h, C = w * g, dx = S * u - C * v, dy = C * u + S * v;
    double u1 = c * u - s * v, v1 = s * u + c * v;
    Matrix F;
    identity(F, 5);
    F[0][2] = S;
    F[0][3] = -C;
    F[0][4] = S_w * u - C_w * v;
    F[1][2] = C;
    F[1][3] = S;
    F[1][4] = C_w * u + S_w * v;
    F[2][2] = c;
    F[2][3] = -s;
    F[2][4] = -t * v1;
    F[3][2] = s;
    F[3][3] = c;
    F[3][4] = t * u1;
    x[0] += dx;
    x[1] += dy;
    x[2] = u1;
    x[3] = v1;
    carry(F, P);
    disturb(P, q * q, 2.0 * h, g, w * h, t);
    swerve(P, q_w * q_w, t, -dy / t, dx / t, -v1, u1);
}

/* ---------------------------------------------------------------- two estimates */

static inline void mix(Mean x, Matrix P, Mean z, Matrix Z, double a, double c) {
    for (int i = 0; i < 5; i++)
        for (int j = 0; j <= i; j++) {
            double apart = (z[i] - x[i]) * (z[j] - x[j]), p = P[i][j], q = Z[i][j];
            P[i][j] = P[j][i] = p + a * (q - p) + a * (1.0 - a) * apart;
            Z[i][j] = Z[j][i] = q + c * (p - q) + c * (1.0 - c) * apart;
        }
    for (int i = 0; i < 5; i++) {
        double d = z[i] - x[i];
        x[i] += a * d;
        z[i] -= c * d;
    }
}

static inline void mean(Mean x, Matrix P, Mean z, Matrix Z, double p, Mean o, Matrix O) {
    for (int i = 0; i < 5; i++) {
        double d = z[i] - x[i];
        o[i] = x[i] + p * d;
        for (int j = 0; j <= i; j++) {
            double straight = j < 4 ? P[i][j] : 0.0;
            O[i][j] = O[j][i] = straight + p * (Z[i][j] - straight) + p * (1.0 - p) * d * (z[j] - x[j]);
        }
    }
}

static double mixed(double p, Mean x, Matrix P, Mean z, Matrix Z, double t, const Gains *g) {
    double change = g->begin + g->end, begins = 0.0, ends = 0.0;
    if (change > 0.0) {
        double share = (1.0 - exp(-change * t)) / change;
        begins = g->begin * share;
        ends = g->end * share;
    }
    double to = p * (1.0 - ends) + (1.0 - p) * begins, away = p * ends + (1.0 - p) * (1.0 - begins);
    mix(x, P, z, Z, away > 0.0 ? p * ends / away : 0.0, to > 0.0 ? (1.0 - p) * begins / to : 0.0);
    return to;
}

/* ---------------------------------------------------------------- correction */

static double loss(double square, double k) {
    return 0.0 < k * k && k * k < square ? k * sqrt(square) - 0.5 * k * k : 0.5 * square;
}

static double more(double square, double k) { return 0.0 < k * k && k * k < square ? sqrt(square) / k : 1.0; }

static inline double correct(Mean x, Matrix P, const Measurement *y, int told, double l_r, const Gains *g) {
    double c = told ? cos(y->heading) : 1.0, s = told ? sin(y->heading) : 0.0, ahead = x[2] * c + x[3] * s;
    double square = ahead * ahead + P[2][2] * c * c + 2.0 * P[3][2] * c * s + P[3][3] * s * s;
    double G[5];
    Columns H;
    Innovation e = against(x, P, H, 5, y, g->noise);
    double far = normalised(&e), w = more(far, g->huber);
    double likely = -0.5 * log(e.xx * e.yy - e.xy * e.xy) - loss(far, g->huber);
    e.xx *= w;
    e.xy *= w;
    e.yy *= w;
    correct_two(x, P, H, 5, &e);
    if (!told) return likely;
    for (int i = 0; i < 5; i++) G[i] = c * P[i][3] - s * P[i][2] - l_r * P[i][4];
    double S = larger(square * heading_scatter(y, g->heading_noise), SLOWEST) + c * G[3] - s * G[2] - l_r * G[4];
    double aside = s * x[2] - c * x[3] + l_r * x[4];
    far = aside * aside / S;
    likely -= 0.5 * log(S) + loss(far, g->huber);
    S *= more(far, g->huber);
    for (int i = 0; i < 5; i++) {
        double gain = G[i] / S;
        x[i] += gain * aside;
        for (int j = 0; j <= i; j++) {
            P[i][j] -= gain * G[j];
            P[j][i] = P[i][j];
        }
    }
    return likely;
}

/* ---------------------------------------------------------------- yaw and acceleration */

static double speed(double u, double v, double psi) {
    double V = sqrt(u * u + v * v);
    return u * cos(psi) + v * sin(psi) >= 0.0 ? V : -V;
}

static void facing(Mean x, Matrix P, double *psi, double *variance, int told, const Gains *g) {
    double u = x[2], v = x[3], l = g->l_r, V = speed(u, v, *psi), square = V * V, most = sin(SLIP_MAX);
    if (!(square > 1e-12)) return;
    double across = (P[2][2] * v * v - 2.0 * P[3][2] * u * v + P[3][3] * u * u) / square;
    int unknown = *variance > PSI_KNOWN * PSI_KNOWN && square > GATE * GATE * across;
    if (V < 0.0 && !told && (unknown || square > g->reverse * g->reverse)) {
        *psi += PI;
        V = -V;
    }
    double chi = atan2(v, u) + (V < 0.0 ? PI : 0.0), beta = asin(clip(l * x[4] / V, most));
    double gain = *variance * square / (*variance * square + across + l * l * P[4][4]);
    *psi += gain * wrap(chi - beta - *psi);
    *variance *= 1.0 - gain;
}

/* ---------------------------------------------------------------- drivers */

static inline void load(const double *row, Mean x, Matrix P, Mean z, Matrix Z, double turn) {
    for (int i = 0; i < 5; i++) {
        x[i] = i < 4 ? row[i] : 0.0;
        z[i] = row[14 + i];
    }
    for (int i = 0, k = 0; i < 5; i++)
        for (int j = 0; j <= i; j++, k++) {
            P[i][j] = P[j][i] = i < 4 ? row[4 + k] : 0.0;
            Z[i][j] = Z[j][i] = row[19 + k];
        }
    P[4][4] = turn * turn;
}

static inline void limit(Mean x, Matrix P) {
    for (int i = 2; i < 5; i++) x[i] = clip(x[i], i < 4 ? V_MAX : W_MAX);
    shrink(P, 5, WIDEST, 5);
}

static inline void store(Mean x, Matrix P, Mean z, Matrix Z, double turning, double psi, double variance, double A,
                         double age, double *row) {
    limit(x, P);
    limit(z, Z);
    for (int i = 0; i < 4; i++) row[i] = x[i];
    for (int i = 0; i < 5; i++) row[14 + i] = z[i];
    for (int i = 0, k = 0; i < 5; i++)
        for (int j = 0; j <= i; j++, k++) {
            if (i < 4) row[4 + k] = P[i][j];
            row[19 + k] = Z[i][j];
        }
    row[34] = turning;
    row[35] = wrap(psi);
    row[36] = variance;
    row[37] = clip(A, A_MAX);
    row[38] = age;
}

static void start(const Measurement *y0, const Measurement *y1, double dt, const Gains *g, double *row) {
    const Measurement *y = seen(y1) ? y1 : y0, *h = pointed(y1) ? y1 : y0;
    Mean x = {y->x, y->y}, z;
    Matrix P = {{0.0}}, Z;
    scatter(y, g->noise, &P[0][0], &P[1][0], &P[1][1]);
    P[2][2] = P[3][3] = V_START * V_START;
    P[4][4] = larger(g->turn * g->turn, 1e-12);
    double psi = 0.0, variance = 1.0;
    if (seen(y0) && seen(y1) && 0.0 < dt && dt < INFINITY) {
        double dx = y1->x - y0->x, dy = y1->y - y0->y, t = larger(dt, 1e-6), xx, xy, yy, a = 0.5 * A_START * t;
        scatter(y0, g->noise, &xx, &xy, &yy);
        x[2] = dx / t;
        x[3] = dy / t;
        P[2][0] = P[0][0] / t;
        P[2][1] = P[3][0] = P[1][0] / t;
        P[3][1] = P[1][1] / t;
        P[2][2] = (P[0][0] + xx) / (t * t) + a * a;
        P[3][2] = (P[1][0] + xy) / (t * t);
        P[3][3] = (P[1][1] + yy) / (t * t) + a * a;
        psi = atan2(dy, dx);
        variance = directed(dx, dy, y0, y1, g->noise, GATE) ? FRESH : 1.0;
    }
    if (g->heading > 0.0 && pointed(h)) {
        psi = wrap(h->heading);
        variance = smaller(heading_scatter(h, g->heading_noise), 1.0);
    }
    mirror(P, 5);
    for (int i = 0; i < 5; i++) {
        z[i] = x[i];
        for (int j = 0; j < 5; j++) Z[i][j] = P[i][j];
    }
    double change = g->begin + g->end;
    store(x, P, z, Z, change > 0.0 ? g->begin / change : 0.5, psi, variance, 0.0, 0.0, row);
}

static void step(const double *now, const Measurement *y, double dt, const Gains *g, double *row) {
    if (!(0.0 < dt && dt < INFINITY)) {
        for (int i = 0; i < STATES; i++) row[i] = now[i];
        return;
    }
    Mean x, z, o;
    Matrix P, Z, O;
    load(now, x, P, z, Z, g->turn);
    double t = smaller(dt, LONGEST), p = now[34], psi = now[35], n = ceil(t / LEAP), h = t / n;
    for (int k = 0; k < n; k++) {
        double w = p * z[4];
        p = mixed(p, x, P, z, Z, h, g);
        go_straight(x, P, h, g->straight, g->turn);
        go_round(z, Z, h, g->turning, g->turn_rate);
        psi += 0.5 * h * (w + p * z[4]);
    }
    double A = now[37] * exp(-t / g->settle), age = smaller(now[38] + t, LONGEST);
    double variance = smaller(larger(now[36], FRESH) + DRIFT * DRIFT * t, 3.0);
    if (seen(y)) {
        int told = g->heading > 0.0 && pointed(y);
        double u = x[2] + p * (z[2] - x[2]), v = x[3] + p * (z[3] - x[3]);
        double more = correct(z, Z, y, told, g->l_r, g) - correct(x, P, y, told, 0.0, g);
        p = p > 0.0 ? p / (p + (1.0 - p) * exp(clip(-more, 700.0))) : 0.0;
        mean(x, P, z, Z, p, o, O);
        if (told) {
            double r = heading_scatter(y, g->heading_noise);
            psi += variance / (variance + r) * wrap(y->heading - psi);
            variance *= r / (variance + r);
        }
        double before = psi;
        facing(o, O, &psi, &variance, told, g);
        if (cos(psi - before) < 0.0) A = -A;
        double V = speed(o[2], o[3], psi);
        double gained = V * V > 0.0 ? ((o[2] - u) * o[2] + (o[3] - v) * o[3]) / V : 0.0;
        A += (1.0 - exp(-age / g->settle)) * gained / age;
        age = 0.0;
    }
    store(x, P, z, Z, p, psi, variance, A, age, row);
}

RUN(start(&m[k - 1], &m[k], h, g, s[k]), step(s[k - 1], &m[k], h, g, s[k]))
