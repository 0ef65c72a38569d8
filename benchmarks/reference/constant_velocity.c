/* The constant-velocity observer of observers/constant_velocity.py in plain scalar C, for its speed. */
#include <math.h>

#define PI 3.141592653589793
#define TAU 6.283185307179586
#define SLIP_MAX (PI / 9.0)
#define FAR 1e8
#define V_MAX 70.0
#define A_MAX 100.0
#define GAP_MAX 5.0
#define WIDEST 20.0
#define LEAST_DT 1e-9
#define SECTOR (2.0 * PI / 5.0)

typedef struct { double X, Y, V, A, psi, beta, run; } State;
typedef struct {
    double L_x, L_y, L_psi, L_beta, speed, speed_chain, switched, floor, l_r, heading, heading_noise, noise,
        huber, coast, reverse;
} Gains;
typedef struct { double x, y, xx, xy, yy, heading, heading_variance, length, width; } Measurement;
typedef struct { double l1, l2, l3; } Chain;
typedef struct { double x, y, turn; } Chord;

static double wrap(double angle) { return angle - TAU * floor(angle / TAU + 0.5); }
static double clip(double v, double limit) { return v > limit ? limit : v < -limit ? -limit : v; }
static double larger(double a, double b) { return b > a ? b : a; }
static int seen(const Measurement *y) { return fabs(y->x) < FAR && fabs(y->y) < FAR; }

static int pointed(const Measurement *y) {
    return fabs(y->heading) < FAR && 0.0 <= y->heading_variance && y->heading_variance < INFINITY;
}

static double heading_or(const Measurement *y, double otherwise) {
    return pointed(y) ? wrap(y->heading) : otherwise;
}

static int directed(double dx, double dy, const Measurement *y0, const Measurement *y1, double noise) {
    double d2 = dx * dx + dy * dy;
    double across = (y0->xx + y1->xx) * dy * dy - 2.0 * (y0->xy + y1->xy) * dx * dy
                    + (y0->yy + y1->yy) * dx * dx;
    return d2 * d2 > 4.0 * larger(across, 2.0 * (noise * noise) * d2) && d2 > 0.0;
}

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

/* Way; speed and acceleration in place. */
static double coast(double *speed, double *acceleration, double dt, double T) {
    double V = *speed, A = *acceleration, t = dt;
    if (V * A < 0.0 && -V / (A * T) < 1.0) {
        double stop = -T * log1p(V / (A * T));
        t = stop < dt ? stop : dt;
    }
    double fade = -expm1(-t / T), way = V * t + A * T * (t - T * fade);
    *speed = t < dt ? 0.0 : V + A * T * fade;
    *acceleration = t < dt ? 0.0 : A * (1.0 - fade);
    return way;
}

static inline Chord chord(double way, double chi, double curvature) {
    double half = 0.5 * way * curvature;
    double length = way * (fabs(half) > 1e-6 ? sin(half) / half : 1.0 - half * half / 6.0);
    Chord c = {length * cos(chi + half), length * sin(chi + half), 2.0 * half};
    return c;
}

/* Weight of the innovation (x, y) with covariance (xx, xy, yy); the run of limited ones in place. */
static double patient_huber(double x, double y, double xx, double xy, double yy, double limit, double *run) {
    double k = *run > 0.0 ? limit * pow(2.0, *run < 30.0 ? *run : 30.0) : limit;
    double determinant = xx * yy - xy * xy, w = 1.0;
    if (k > 0.0 && determinant > 0.0) {
        double square = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant;
        if (!(square <= k * k)) w = k / sqrt(square);
    }
    *run = w < 1.0 ? *run + 1.0 : 0.0;
    return w;
}

static double heading_innovation(double psi, const Measurement *y, double noise, double k, double *trust) {
    double variance = noise * noise + y->heading_variance;
    *trust = variance > 0.0 ? noise * noise / variance : 1.0;
    return clip(wrap(y->heading - psi), k > 0.0 ? k * sqrt(variance) : PI);
}

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
    if (0.0 < dt && dt < INFINITY && directed(dx, dy, y0, y1, g->noise)) {
        r.V = hypot(dx, dy) / dt;
        if (!(g->heading > 0.0)) r.psi = course;
        else if (dx * cos(r.psi) + dy * sin(r.psi) < 0.0) r.V = -r.V;
    }
    return limited(&r, g, INFINITY);
}

static State moved(const State *s, double way, double V, double A, const Gains *g) {
    Chord c = chord(way, s->psi + s->beta, sin(s->beta) / g->l_r);
    State r = {s->X + c.x, s->Y + c.y, V, A, wrap(s->psi + c.turn), s->beta, s->run};
    return r;
}

static State predict(const State *s, double dt, const Gains *g) {
    if (!(0.0 < dt && dt < INFINITY)) return *s;
    double V = s->V, A = s->A, way = coast(&V, &A, dt, g->coast);
    return moved(s, way, V, A, g);
}

static State step(const State *before, const Measurement *previous, const Measurement *y, double dt,
                  const Gains *g) {
    (void)previous;
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
    double wide = 1.0 / larger(1.0 - larger(ahead.l1, across.l1), 1.0 / WIDEST), least = g->noise * g->noise;
    double dx = y->x - s.X, dy = y->y - s.Y;
    double xx = wide * (y->xx + least), yy = wide * (y->yy + least);
    double w = patient_huber(dx, dy, xx, wide * y->xy, yy, g->huber, &run);
    double frame = s.psi + s.beta;
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

void run(const double *y, const double *dt, const double *gains, double *out, long n, long T) {
    const Gains *g = (const Gains *)gains;
    for (long i = 0; i < n; i++) {
        const Measurement *m = (const Measurement *)y + i * T;
        State *s = (State *)out + i * T;
        int started = 0;
        for (long k = 0; k < T; k++) {
            double first = k ? m[k - 1].x + m[k - 1].y + m[k].x + m[k].y : NAN;
            if (started) {
                s[k] = step(&s[k - 1], &m[k - 1], &m[k], dt[i * T + k], g);
            } else if (first == first) {
                s[k] = start(&m[k - 1], &m[k], dt[i * T + k], g);
                started = 1;
            } else {
                State none = {NAN, NAN, NAN, NAN, NAN, NAN, NAN};
                s[k] = none;
            }
        }
    }
}
