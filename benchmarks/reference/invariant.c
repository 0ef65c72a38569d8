/* The invariant observer of observers/invariant.py in plain scalar C, to measure its speed against. */
#define SLIP_MAX (PI / 6.0)
#include "common.h"

#define SHAPE_ALONG 0.8
#define SHAPE_ACROSS 0.5
#define POSITION 0.1
#define SPEED 10.0
#define HEADING 0.1
#define REVERSE 4.0
#define CONTRARY 3.0
#define RUN_MAX 30.0
#define LONG 1e3
#define GAP 10.0
#define SHORT 1e-4
#define FAR_R 1e6

typedef struct { double x, y, chi, V, A, k, beta, age, blind, run, contrary; } State;
typedef struct {
    double tau, arc, turn, yaw, share, cross, relax, v0, heading, noise, heading_noise, huber, widen, ramp, coast,
        lag, l_r;
} Gains;
typedef struct { double p, v, a; } Axis;
typedef struct { Axis along, across; double offset, course, curvature, yaw; } Correction;

static State limited(State s, const Gains *g) {
    double k = sin(SLIP_MAX) / g->l_r;
    s.chi = wrap(s.chi);
    s.V = clip(s.V, V_MAX);
    s.A = clip(s.A, A_MAX);
    s.k = clip(s.k, k);
    s.beta = clip(s.beta, SLIP_MAX);
    s.age = smaller(s.age, LONG);
    s.blind = smaller(s.blind, LONG);
    return s;
}

static State driven(const State *s, double dt, const Gains *g) {
    double T = g->coast, gone = -expm1(-dt / T);
    double D = s->V * dt + s->A * T * (dt - T * gone);
    Chord c = chord(D, s->chi, 0.5 * D * s->k);
    double rolling = asin(clip(g->l_r * s->k, 0.5)), beta = s->beta;
    if (dt > 0.0) beta = rolling + (beta - rolling) * exp(-fabs(D) / g->relax);
    State r = {
        s->x + c.x,
        s->y + c.y,
        s->chi + c.turn,
        s->V + s->A * T * gone,
        s->A * (1.0 - gone),
        s->k, beta, s->age + dt, s->blind + dt, s->run, s->contrary,
    };
    return r;
}

static Axis placed(double d, double shape, double fade) {
    double real = exp(-d), w = sqrt(fabs(shape * shape - 1.0)), both, product = exp(-2.0 * d * shape);
    if (shape < 1.0) both = 2.0 * exp(-d * shape) * cos(d * w);
    else both = exp(-d * (shape - w)) + exp(-d * (shape + w));
    double q1 = real + both, q2 = real * both + product, q3 = real * product;
    double f = exp(-fade), g = 1.0, half = 0.5;
    if (fade > 1e-4) {
        g = -expm1(-fade) / fade;
        half = (1.0 - g) / fade;
    }
    double p = 2.0 + f - q1, a = (((f - q1) * f + q2) * f - q3) / (g * g);
    double v = q2 - f - (1.0 + f) * (1.0 - p) - a * half;
    a /= f;
    v -= g * a;
    Axis c = {p - v - half * a, v, a};
    return c;
}

static Correction correction(
    double dt, double V, double age, double along, double across, double heading, const Gains *g
) {
    dt = smaller(larger(dt, SHORT), GAP);
    age = larger(age, dt);
    double speed = fabs(V) + g->v0, ds = speed * dt;
    double tau = g->tau * pow(along / (POSITION * POSITION), 1.0 / 6.0);
    double arc = g->arc * pow(across / (POSITION * POSITION), 1.0 / 6.0) * pow(speed / SPEED, 1.0 / 3.0);
    double deviation = larger(sqrt(heading), 1e-3) / HEADING;
    double turn = g->turn * sqrt(deviation), yaw = g->yaw * deviation;
    if (g->ramp > 0.0) {
        double wide = g->ramp * age;
        tau = smaller(tau, wide);
        arc = smaller(arc, speed * wide);
        turn = smaller(turn, speed * wide);
        yaw = smaller(yaw, age);
    }
    Axis s = placed(dt / tau, SHAPE_ALONG, dt / g->coast), n = placed(ds / arc, SHAPE_ACROSS, 0.0);
    double left = exp(-ds / turn), course = 1.0 - left * left;
    Correction L = {
        {s.p, s.v / dt, s.a / (dt * dt)},
        {n.p, n.v / ds, n.a / (ds * ds)},
        g->cross * n.p * arc * course,
        course,
        (1.0 - left) * (1.0 - left) / ds,
        -expm1(-dt / yaw),
    };
    return L;
}

static State predict(const State *s, double dt, const Gains *g) {
    if (!(0.0 < dt && dt < INFINITY)) return *s;
    double stop = stop_time(s->V, s->A, g->coast);
    State r = driven(s, smaller(dt, stop), g);
    if (stop <= dt) {
        r.V = r.A = 0.0;
        r.age += dt - stop;
        r.blind += dt - stop;
    }
    return limited(r, g);
}

static State corrected(
    const State *s, double along, double across, const Measurement *y, double sigma, const Correction *L,
    double run, const Gains *g
) {
    int points = g->heading > 0.0 && pointed(y);
    double side = larger(-1.0, smaller(1.0, 1.0 + 2.0 * s->V / g->v0)), e = 0.0, left = 1.0;
    double contrary = s->contrary;
    if (points) {
        double whole = wrap(y->heading - s->chi + s->beta);
        int back = fabs(whole) > 0.5 * PI;
        contrary = back ? contrary + 1.0 : 0.0;
        if (back) whole = wrap(whole + PI);
        e = g->huber > 0.0 ? clip(whole, g->huber * sigma) : whole;
        left = 1.0 - L->course * (e != whole ? e / whole : 1.0);
    }
    double by_place = side * left * L->across.v * across;
    double turned = by_place + L->course * e, yawed = g->share * by_place + L->yaw * e;
    double bend = left * L->across.a * across + side * L->curvature * e;
    double offset = L->across.p * across + side * L->offset * e;
    double c = cos(s->chi), n = sin(s->chi);
    State r = {
        s->x + c * L->along.p * along - n * offset,
        s->y + n * L->along.p * along + c * offset,
        s->chi + turned,
        s->V + L->along.v * along,
        s->A + L->along.a * along,
        s->k + bend,
        s->beta + turned - yawed,
        s->age, 0.0, run, contrary,
    };
    if (points ? contrary >= CONTRARY : r.V < -REVERSE) {
        r.chi += PI;
        r.V = -r.V;
        r.A = -r.A;
        r.k = -r.k;
        r.contrary = 0.0;
    }
    return limited(r, g);
}

static State step(const State *state, const Measurement *y, double dt, const Gains *g) {
    if (!(seen(y) && 0.0 < dt && dt < INFINITY)) return predict(state, dt, g);
    State s = limited(driven(state, dt, g), g);
    double c = cos(s.chi), n = sin(s.chi);
    double along = c * (y->x - s.x) + n * (y->y - s.y), across = c * (y->y - s.y) - n * (y->x - s.x);
    double least = larger(g->noise, 1e-3) * larger(g->noise, 1e-3);
    double r_along = y->xx * c * c + 2.0 * y->xy * c * n + y->yy * n * n;
    double r_across = y->xx * n * n - 2.0 * y->xy * c * n + y->yy * c * c;
    r_along = (r_along < FAR_R ? larger(r_along, 0.0) : FAR_R) + least;
    r_across = (r_across < FAR_R ? larger(r_across, 0.0) : FAR_R) + least;
    double r_heading = HEADING * HEADING;
    if (pointed(y)) r_heading = smaller(y->heading_variance, FAR_R) + g->heading_noise * g->heading_noise;
    Correction L = correction(s.blind, s.V, s.age, r_along, r_across, r_heading, g);
    double square = along * along * (1.0 - L.along.p) / r_along + across * across * (1.0 - L.across.p) / r_across;
    double limit = g->huber * pow(g->widen, s.run), u = 1.0, run = 0.0;
    if (g->huber > 0.0 && square > limit * limit) {
        u = limit / sqrt(square);
        run = smaller(s.run + 1.0, RUN_MAX);
    }
    return corrected(&s, u * along, u * across, y, sqrt(r_heading), &L, run, g);
}

static State start(const Measurement *y0, const Measurement *y1, double dt, const Gains *g) {
    State s = {y1->x, y1->y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    double dx = y1->x - y0->x, dy = y1->y - y0->y;
    if (!(seen(y0) && seen(y1))) { /* the loop starts on two finite neighbours, which may still be too far out */
        const Measurement *y = seen(y1) ? y1 : y0;
        s.x = y->x;
        s.y = y->y;
        s.chi = heading_or(y, 0.0);
        return s;
    }
    if (!(0.0 < dt && dt < INFINITY)) {
        s.chi = heading_or(y1, 0.0);
        return s;
    }
    s.chi = wrap(atan2(dy, dx));
    s.age = dt;
    if (g->heading > 0.0 && pointed(y1)) {
        s.chi = wrap(y1->heading);
        s.V = (dx * cos(s.chi) + dy * sin(s.chi)) / dt;
    } else if (directed(dx, dy, y0, y1, g->noise, GATE)) {
        s.V = hypot(dx, dy) / dt;
    }
    return limited(s, g);
}

RUN(s[k] = start(&m[k - 1], &m[k], h, g), s[k] = step(&s[k - 1], &m[k], h, g))
