/* The high-gain observer of observers/high_gain.py in plain scalar C, to measure its speed against. */
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
#define SUBSTEP 0.1

typedef struct { double X, dX, ddX, Y, dY, ddY, psi, run; } State;
typedef struct { double X, Y, V, A, psi, beta; } Vehicle;
typedef struct {
    double L1, L2, L3, c_max, floor, l_r, heading, turn, heading_noise, noise, huber, coast, reverse;
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
    if (!(0.0 < dt && dt < INFINITY && directed(dx, dy, y0, y1, g->noise))) return r;
    if (!(g->heading > 0.0)) r.psi = way;
    r.dX = dx / dt;
    r.dY = dy / dt;
    return limited(&r, INFINITY);
}

static State predict(const State *s, double dt, const Gains *g) {
    if (!(0.0 < dt && dt < INFINITY)) return *s;
    Vehicle v = to_vehicle(s, g);
    double way = coast(&v.V, &v.A, dt, g->coast);
    Chord c = chord(way, v.psi + v.beta, sin(v.beta) / g->l_r);
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

static State step(const State *before, const Measurement *previous, const Measurement *y, double dt,
                  const Gains *g) {
    (void)previous;
    if (!(seen(y) && dt <= GAP_MAX)) return predict(before, dt, g);
    if (!(dt > 0.0)) return *before;
    double n = ceil(dt / SUBSTEP), psi = turned(before, dt, g), run = before->run;
    State s = rk4(*before, g, dt, n < 1.0 ? 1 : n > 50.0 ? 50 : (int)n);
    Chain l = chain_gains(g->L1, g->L2, g->L3, dt);
    double wide = 1.0 / larger(1.0 - l.l1, 1.0 / WIDEST), least = g->noise * g->noise;
    double ex = y->x - s.X, ey = y->y - s.Y;
    double xx = wide * (y->xx + least), yy = wide * (y->yy + least);
    double w = patient_huber(ex, ey, xx, wide * y->xy, yy, g->huber, &run);
    int known = g->heading > 0.0 && pointed(y);
    ex *= w;
    ey *= w;
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
                State none = {NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN};
                s[k] = none;
            }
        }
    }
}
