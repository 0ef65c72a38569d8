/* The multi-stage observer of observers/multi_stage.py in plain scalar C, to measure its speed against. */
#include "common.h"

#define J_MAX 1000.0
#define HEADING_VARIANCE 0.01
#define SPEEDS 21

static const double NOMINAL[SPEEDS] = {1.0,  1.5,  2.0,  3.0,  4.0,  5.0,  6.0,  7.0,  8.0,  9.0, 10.0,
                                       11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 17.0, 18.0, 19.0, 20.0};
static const double L_PSI[SPEEDS] = {0.89, 0.98, 1.37, 1.76, 2.52, 3.67, 5.47, 8.05,  9.70,  5.58, 6.08,
                                     6.60, 7.14, 7.70, 8.27, 8.84, 9.42, 9.99, 10.49, 10.97, 11.44};
static const double L_BETA[SPEEDS] = {0.25, 0.27, 0.30, 0.33, 0.37, 0.50, 0.70, 0.99, 1.17, 0.66, 0.68,
                                      0.71, 0.74, 0.77, 0.79, 0.82, 0.85, 0.88, 0.89, 0.91, 0.92};

typedef struct { double S, V, A, J, psi, beta, x, y; } State;
typedef struct { double S, alpha, psi, x, y; } Output;
typedef struct { double L_S, L_V, L_A, L_J, L_psi, L_beta, L_heading, L_w, l_r; } Coefficients;
typedef struct {
    double L_S, L_V, L_A, L_J, L_w, l_r, speed, orientation, heading, noise, gate, coast, reverse;
    double psi_0, psi_V, beta_0, beta_V;
} Gains;

static inline State rhs(const State *s, const Output *y, const Coefficients *c) {
    double eS = y->S - s->S, chi = s->psi + s->beta, e = wrap(y->alpha - chi);
    double beta = clip(s->beta, SLIP_MAX);
    State d = {
        s->V + c->L_S * eS,
        s->A + c->L_V * eS,
        s->J + c->L_A * eS,
        c->L_J * eS,
        s->V * sin(beta) / c->l_r + c->L_psi * e + c->L_heading * wrap(y->psi - s->psi),
        c->L_beta * e,
        s->V * cos(chi) + c->L_w * (y->x - s->x),
        s->V * sin(chi) + c->L_w * (y->y - s->y),
    };
    return d;
}

static inline State along(const State *a, const State *b, double h) {
    State r = {a->S + h * b->S,     a->V + h * b->V,       a->A + h * b->A, a->J + h * b->J,
               a->psi + h * b->psi, a->beta + h * b->beta, a->x + h * b->x, a->y + h * b->y};
    return r;
}

static inline Output at(const Output *y, const Output *dy, double t) {
    Output r = {y->S + t * dy->S, y->alpha + t * dy->alpha, y->psi + t * dy->psi, y->x + t * dy->x,
                y->y + t * dy->y};
    return r;
}

static State rk4(State s, const Output *y, const Output *dy, const Coefficients *c, double dt, int n) {
    double h = dt / n;
    for (int i = 0; i < n; i++) {
        Output first = at(y, dy, i * h), middle = at(y, dy, (i + 0.5) * h), last = at(y, dy, (i + 1) * h);
        State k1 = rhs(&s, &first, c), s2 = along(&s, &k1, 0.5 * h);
        State k2 = rhs(&s2, &middle, c), s3 = along(&s, &k2, 0.5 * h);
        State k3 = rhs(&s3, &middle, c), s4 = along(&s, &k3, h);
        State k4 = rhs(&s4, &last, c);
        s = along(&s, &k1, h / 6.0);
        s = along(&s, &k2, h / 3.0);
        s = along(&s, &k3, h / 3.0);
        s = along(&s, &k4, h / 6.0);
    }
    return s;
}

static Coefficients coefficients(const State *s, const Measurement *y, int moved, int clear, const Gains *g) {
    int i = 0;
    double speed = fabs(s->V);
    while (i + 1 < SPEEDS && fabs(NOMINAL[i + 1] - speed) < fabs(NOMINAL[i] - speed)) i++;
    double L_psi = g->orientation * L_PSI[i], L_beta = g->orientation * L_BETA[i], L_heading = 0.0;
    if (g->psi_V > 0.0) {
        L_psi = g->orientation * (g->psi_0 + g->psi_V * speed);
        L_beta = g->orientation * (g->beta_0 + g->beta_V * speed);
    }
    if (s->V < 0.0) {
        L_psi = L_psi + 2.0 * L_beta;
        L_beta = -L_beta;
    }
    if (!clear) L_psi = L_beta = 0.0;
    if (pointed(y)) L_heading = g->heading * HEADING_VARIANCE / (HEADING_VARIANCE + y->heading_variance);
    double k = moved ? g->speed : 0.0, k2 = k * k;
    Coefficients c = {g->L_S * k, g->L_V * k2, g->L_A * (k * k2), g->L_J * (k2 * k2), L_psi, L_beta,
                      L_heading,  g->L_w,      g->l_r};
    return c;
}

static State limited(const State *s, double S, double reverse) {
    double V = clip(s->V, V_MAX), A = clip(s->A, A_MAX), J = clip(s->J, J_MAX);
    double beta = clip(s->beta, SLIP_MAX);
    if (s->V + reverse < 0.0) {
        State r = {-S, -V, -A, -J, wrap(s->psi + 2.0 * beta + PI), -beta, s->x, s->y};
        return r;
    }
    State r = {S, V, A, J, wrap(s->psi), beta, s->x, s->y};
    return r;
}

static State start(const Measurement *y0, const Measurement *y1, double dt, const Gains *g) {
    double dx = y1->x - y0->x, dy = y1->y - y0->y, alpha = atan2(dy, dx);
    State r = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, y1->x, y1->y};
    if (!(seen(y0) && seen(y1))) {
        const Measurement *y = seen(y1) ? y1 : y0;
        r.psi = heading_or(y, 0.0);
        r.x = y->x;
        r.y = y->y;
    } else if (0.0 < dt && dt < INFINITY && directed(dx, dy, y0, y1, g->noise, g->gate)) {
        double V = hypot(dx, dy) / dt;
        r.V = V > V_MAX ? V_MAX : V;
        r.psi = wrap(alpha);
    } else {
        r.psi = heading_or(y1, heading_or(y0, wrap(alpha)));
    }
    return r;
}

static State predict(const State *s, double dt, const Gains *g) {
    if (!(0.0 < dt && dt < INFINITY)) return *s;
    double V = s->V, A = s->A, T = g->coast, t = smaller(dt, stop_time(V, A, T));
    double fade = exp(-t / T), D = V * t + A * T * (t - T * (1.0 - fade));
    if (t < dt) {
        V = 0.0;
        A = 0.0;
    } else {
        V = V + A * T * (1.0 - fade);
        A = A * fade;
    }
    Chord c = chord(D, s->psi + s->beta, 0.5 * D * sin(s->beta) / g->l_r);
    State r = {0.0, V, A, 0.0, s->psi + c.turn, s->beta, s->x + c.x, s->y + c.y};
    return limited(&r, 0.0, INFINITY);
}

static State step(const State *s, const Measurement *previous, const Measurement *y, double dt,
                  const Gains *g) {
    if (!(seen(y) && dt <= GAP_MAX)) return predict(s, dt, g);
    if (!(dt > 0.0)) return *s;
    Measurement before = {s->x,   s->y,     y->xx,     y->xy,   y->yy,
                          s->psi, INFINITY, y->length, y->width};
    if (seen(previous)) before = *previous;
    double dx = y->x - before.x, dy = y->y - before.y;
    double chi = s->psi + s->beta + 0.5 * dt * s->V * sin(s->beta) / g->l_r;
    double c = cos(chi), sn = sin(chi), way = dx * c + dy * sn, aside = dy * c - dx * sn;
    double e = way >= 0.0 ? atan2(aside, way) : atan2(-aside, -way);
    int moved = hypot(dx, dy) <= V_MAX * dt + g->noise;
    int clear = moved && directed(dx, dy, &before, y, g->noise, g->gate);
    Coefficients k = coefficients(s, y, moved, clear, g);
    double psi0 = heading_or(&before, heading_or(y, s->psi));
    double turn = wrap(heading_or(y, psi0) - psi0);
    Output begin = {0.0, chi + e, psi0, before.x, before.y};
    double d = larger(dt, LEAST_DT);
    Output rate = {way / d, 0.0, turn / d, dx / d, dy / d};
    double fastest = larger(larger(k.L_S, k.L_w), fabs(k.L_psi + k.L_beta) + k.L_heading);
    double n = ceil(2.0 * dt * fastest);
    State r = rk4(*s, &begin, &rate, &k, dt, n < 4.0 ? 4 : n > 1000.0 ? 1000 : (int)n);
    return limited(&r, moved ? r.S - way : s->S, k.L_heading > 0.0 ? INFINITY : g->reverse);
}

RUN(s[k] = start(&m[k - 1], &m[k], h, g), s[k] = step(&s[k - 1], &m[k - 1], &m[k], h, g))
