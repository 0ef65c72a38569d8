/* The constant-velocity observer of observers/constant_velocity.py in plain scalar C, for its speed. */
#include "common.h"

#define SECTOR (2.0 * PI / 5.0)

typedef struct { double X, Y, V, A, psi, beta, run; } State;
typedef struct {
    double L_x, L_y, L_psi, L_beta, speed, speed_chain, switched, floor, l_r, heading, heading_noise, noise,
        huber, coast, reverse;
} Gains;

static State limited(const State *s, const Gains *g, double reverse) {
    double beta = clip(s->beta, SLIP_MAX), V = clip(s->V, V_MAX), A = clip(s->A, A_MAX);
    State given = {s->X, s->Y, g->speed, 0.0, wrap(s->psi), beta, s->run};
    if (!(g->speed_chain > 0.0)) return given;
    if (V + reverse < 0.0) {
        State r = {s->X, s->Y, -V, -A, wrap(s->psi + 2.0 * beta + PI), -beta, s->run};
        return r;
    }
    State r = {s->X, s->Y, V, A, wrap(s->psi), beta, s->run};
    return r;
}

static State start(const Measurement *y0, const Measurement *y1, double dt, const Gains *g) {
    State r = {y1->x, y1->y, 0.0, 0.0, 0.0, 0.0, 0.0};
    if (!(seen(y0) && seen(y1))) {
        const Measurement *y = seen(y1) ? y1 : y0;
        r.X = y->x;
        r.Y = y->y;
        r.psi = heading_or(y, 0.0);
        return limited(&r, g, INFINITY);
    }
    double dx = y1->x - y0->x, dy = y1->y - y0->y, course = atan2(dy, dx);
    r.psi = heading_or(y1, heading_or(y0, course));
    if (0.0 < dt && dt < INFINITY && directed(dx, dy, y0, y1, g->noise, GATE)) {
        r.V = hypot(dx, dy) / dt;
        if (!(g->heading > 0.0)) r.psi = course;
        else if (dx * cos(r.psi) + dy * sin(r.psi) < 0.0) r.V = -r.V;
    }
    return limited(&r, g, INFINITY);
}

static State moved(const State *s, double way, double V, double A, const Gains *g) {
    Chord c = chord(way, s->psi + s->beta, 0.5 * way * (sin(s->beta) / g->l_r));
    State r = {s->X + c.x, s->Y + c.y, V, A, wrap(s->psi + c.turn), s->beta, s->run};
    return r;
}

static State predict(const State *s, double dt, const Gains *g) {
    if (!(0.0 < dt && dt < INFINITY)) return *s;
    double V = s->V, A = s->A, way = coast(&V, &A, dt, g->coast);
    return moved(s, way, V, A, g);
}

static State step(const State *before, const Measurement *y, double dt, const Gains *g) {
    if (!(seen(y) && dt <= GAP_MAX)) return predict(before, dt, g);
    if (!(dt > 0.0)) return *before;
    double V = before->V, A = before->A, run = before->run;
    State s = moved(before, V * dt + 0.5 * A * dt * dt, V + A * dt, A, g);
    Chain across = chain_gains(g->L_y, g->speed * (g->L_psi + g->L_beta),
                               g->speed * g->speed / g->l_r * g->L_beta, dt);
    Chain ahead = {-expm1(-g->L_x * dt), 0.0, 0.0};
    if (g->speed_chain > 0.0) {
        double r = 1.0 / g->speed_chain;
        ahead = chain_gains(3.0 * r, 3.0 * r * r, r * r * r, dt);
    }
    double dx = y->x - s.X, dy = y->y - s.Y;
    Innovation i = widened(dx, dy, y, larger(ahead.l1, across.l1), g->noise);
    double w = patient_huber(&i, g->huber, &run), frame = s.psi + s.beta;
    if (g->switched > 0.0) frame = SECTOR * rint(frame / SECTOR);
    double c = cos(frame), d = sin(frame), ex = w * (c * dx + d * dy), ey = w * (c * dy - d * dx);
    double slow = 1.0 / larger(fabs(s.V), g->floor);
    double chi = clip(across.l2 * ey * s.V * slow * slow, 1.0);
    double beta = across.l3 * ey * g->l_r * fabs(s.V) * (slow * slow * slow);
    double psi = s.psi + chi - beta;
    int known = g->heading > 0.0 && pointed(y);
    if (known) {
        double trust, e = heading_innovation(psi, y, g->heading_noise, g->huber, &trust);
        double turn = -expm1(-g->heading * trust * dt) * e;
        psi += turn;
        if (s.V < 0.0) beta -= turn;
    }
    double a = ahead.l1 * ex, b = across.l1 * ey;
    State r = {s.X + c * a - d * b, s.Y + d * a + c * b, s.V + ahead.l2 * ex, s.A + ahead.l3 * ex,
               psi, s.beta + beta, run};
    return limited(&r, g, known ? INFINITY : g->reverse);
}

RUN(s[k] = start(&m[k - 1], &m[k], h, g), s[k] = step(&s[k - 1], &m[k], h, g))
