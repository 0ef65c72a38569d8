/* The high-gain observer of observers/high_gain.py in plain scalar C, to measure its speed against. */
#include "common.h"

#define SUBSTEP 0.1

typedef struct { double X, dX, ddX, Y, dY, ddY, psi, run; } State;
typedef struct { double X, Y, V, A, psi, beta; } Vehicle;
typedef struct {
    double L1, L2, L3, c_max, floor, l_r, heading, turn, heading_noise, noise, huber, coast, reverse;
} Gains;

static inline double course_rate(const State *s, const Gains *g) {
    double V2 = larger(s->dX * s->dX + s->dY * s->dY, g->floor * g->floor);
    return clip((s->ddY * s->dX - s->ddX * s->dY) / V2, g->c_max);
}

static inline State rhs(const State *s, const Gains *g) {
    double k = course_rate(s, g);
    State d = {s->dX, s->ddX, -3.0 * s->ddY * k + 2.0 * s->dX * k * k,
               s->dY, s->ddY, 3.0 * s->ddX * k + 2.0 * s->dY * k * k, 0.0, 0.0};
    return d;
}

static inline State along(const State *a, const State *b, double h) {
    State r = {a->X + h * b->X,   a->dX + h * b->dX,   a->ddX + h * b->ddX, a->Y + h * b->Y,
               a->dY + h * b->dY, a->ddY + h * b->ddY, a->psi + h * b->psi, a->run + h * b->run};
    return r;
}

static State rk4(State s, const Gains *g, double dt, int n) {
    double h = dt / n;
    for (int i = 0; i < n; i++) {
        State k1 = rhs(&s, g), s2 = along(&s, &k1, 0.5 * h);
        State k2 = rhs(&s2, g), s3 = along(&s, &k2, 0.5 * h);
        State k3 = rhs(&s3, g), s4 = along(&s, &k3, h);
        State k4 = rhs(&s4, g);
        s = along(&s, &k1, h / 6.0);
        s = along(&s, &k2, h / 3.0);
        s = along(&s, &k3, h / 3.0);
        s = along(&s, &k4, h / 6.0);
    }
    return s;
}

static Vehicle to_vehicle(const State *s, const Gains *g) {
    double V = hypot(s->dX, s->dY), c = cos(s->psi), d = sin(s->psi);
    if (s->dX * c + s->dY * d < 0.0) V = -V;
    if (V == 0.0) {
        Vehicle v = {s->X, s->Y, 0.0, s->ddX * c + s->ddY * d, s->psi, 0.0};
        return v;
    }
    double A = (s->dX * s->ddX + s->dY * s->ddY) / V;
    double beta = asin(clip(g->l_r * course_rate(s, g) / V, sin(SLIP_MAX)));
    double course = V > 0.0 ? atan2(s->dY, s->dX) : atan2(-s->dY, -s->dX);
    Vehicle v = {s->X, s->Y, V, A, wrap(course - beta), beta};
    return v;
}

static State limited(const State *s, double reverse) {
    double V2 = s->dX * s->dX + s->dY * s->dY, A2 = s->ddX * s->ddX + s->ddY * s->ddY, psi = s->psi;
    double v = V2 > V_MAX * V_MAX ? V_MAX / sqrt(V2) : 1.0, a = A2 > A_MAX * A_MAX ? A_MAX / sqrt(A2) : 1.0;
    if (reverse < INFINITY && v * (s->dX * cos(psi) + s->dY * sin(psi)) < -reverse) {
        psi += 2.0 * wrap(atan2(-s->dY, -s->dX) - psi) + PI;
    }
    State r = {s->X, v * s->dX, a * s->ddX, s->Y, v * s->dY, a * s->ddY, wrap(psi), s->run};
    return r;
}

static State start(const Measurement *y0, const Measurement *y1, double dt, const Gains *g) {
    State r = {y1->x, 0.0, 0.0, y1->y, 0.0, 0.0, 0.0, 0.0};
    if (!(seen(y0) && seen(y1))) {
        const Measurement *y = seen(y1) ? y1 : y0;
        r.X = y->x;
        r.Y = y->y;
        r.psi = heading_or(y, 0.0);
        return r;
    }
    double dx = y1->x - y0->x, dy = y1->y - y0->y, way = wrap(atan2(dy, dx));
    r.psi = heading_or(y1, heading_or(y0, way));
    if (!(0.0 < dt && dt < INFINITY && directed(dx, dy, y0, y1, g->noise, GATE))) return r;
    if (!(g->heading > 0.0)) r.psi = way;
    r.dX = dx / dt;
    r.dY = dy / dt;
    return limited(&r, INFINITY);
}

static State predict(const State *s, double dt, const Gains *g) {
    if (!(0.0 < dt && dt < INFINITY)) return *s;
    Vehicle v = to_vehicle(s, g);
    double way = coast(&v.V, &v.A, dt, g->coast);
    Chord c = chord(way, v.psi + v.beta, 0.5 * way * (sin(v.beta) / g->l_r));
    double course = v.psi + c.turn + v.beta, along = cos(course), across = sin(course);
    double a = v.V * v.V * sin(v.beta) / g->l_r;
    State r = {v.X + c.x, v.V * along,  v.A * along - a * across, v.Y + c.y,
               v.V * across, v.A * across + a * along, wrap(s->psi + c.turn), s->run};
    return r;
}

static double turned(const State *s, double dt, const Gains *g) {
    double V = sqrt(s->dX * s->dX + s->dY * s->dY);
    double sign = s->dX * cos(s->psi) + s->dY * sin(s->psi) < 0.0 ? -1.0 : 1.0;
    double x = V * dt / g->l_r, drawn = -expm1(-x), part = x > 1e-9 ? drawn / x : 1.0;
    double aside = V > 0.0 ? wrap(atan2(sign * s->dY, sign * s->dX) - s->psi) : 0.0;
    return wrap(s->psi + drawn * aside + (1.0 - sign * part) * dt * course_rate(s, g));
}

static State step(const State *before, const Measurement *y, double dt, const Gains *g) {
    if (!(seen(y) && dt <= GAP_MAX)) return predict(before, dt, g);
    if (!(dt > 0.0)) return *before;
    double n = ceil(dt / SUBSTEP), psi = turned(before, dt, g), run = before->run;
    State s = rk4(*before, g, dt, n < 1.0 ? 1 : n > 50.0 ? 50 : (int)n);
    Chain l = chain_gains(g->L1, g->L2, g->L3, dt);
    Innovation i = widened(y->x - s.X, y->y - s.Y, y, l.l1, g->noise);
    double w = patient_huber(&i, g->huber, &run), ex = w * i.x, ey = w * i.y;
    int known = g->heading > 0.0 && pointed(y);
    if (known) {
        double trust, e = heading_innovation(psi, y, g->heading_noise, g->huber, &trust);
        psi -= expm1(-g->heading * trust * dt) * e;
        double angle = -expm1(-g->turn * trust * dt) * e, c = cos(angle), d = sin(angle);
        State r = {s.X, c * s.dX - d * s.dY, c * s.ddX - d * s.ddY,
                   s.Y, c * s.dY + d * s.dX, c * s.ddY + d * s.ddX, s.psi, s.run};
        s = r;
    }
    State r = {s.X + l.l1 * ex, s.dX + l.l2 * ex, s.ddX + l.l3 * ex, s.Y + l.l1 * ey, s.dY + l.l2 * ey,
               s.ddY + l.l3 * ey, psi, run};
    return limited(&r, known ? INFINITY : g->reverse);
}

RUN(s[k] = start(&m[k - 1], &m[k], h, g), s[k] = step(&s[k - 1], &m[k], h, g))
