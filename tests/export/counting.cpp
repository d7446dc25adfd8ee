// Numbers that count what is done with them: the operations of sf_flow.c, built as C++.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>

struct Counted {
    double v;
    static long counts[5];  // additions, multiplications, divisions, roots, functions
    Counted() : v(0) {}
    template <class T> Counted(T x) : v(static_cast<double>(x)) {}
    Counted of(int kind, double value) const { counts[kind]++; return Counted(value); }
    Counted operator-() const { return Counted(-v); }  // a sign costs nothing
    Counted operator+(const Counted &o) const { return of(0, v + o.v); }
    Counted operator-(const Counted &o) const { return of(0, v - o.v); }
    Counted operator*(const Counted &o) const { return of(1, v * o.v); }
    Counted operator/(const Counted &o) const { return of(2, v / o.v); }
    Counted &operator+=(const Counted &o) { return *this = *this + o; }
    Counted &operator-=(const Counted &o) { return *this = *this - o; }
    Counted &operator*=(const Counted &o) { return *this = *this * o; }
    bool operator<(const Counted &o) const { return v < o.v; }
    bool operator>(const Counted &o) const { return v > o.v; }
    bool operator<=(const Counted &o) const { return v <= o.v; }
    bool operator>=(const Counted &o) const { return v >= o.v; }
};
long Counted::counts[5];
inline Counted sqrt(Counted x) { return x.of(3, std::sqrt(x.v)); }
inline Counted sin(Counted x) { return x.of(4, std::sin(x.v)); }
inline Counted cos(Counted x) { return x.of(4, std::cos(x.v)); }
inline Counted log(Counted x) { return x.of(4, std::log(x.v)); }
inline Counted fabs(Counted x) { return Counted(std::fabs(x.v)); }

#define double Counted
#include "sf_flow.c"
#undef double

static sf_flow flow;

static void show(const char *what) {
    std::printf("%s", what);
    for (long &count : Counted::counts) {
        std::printf(" %ld", count);
        count = 0;
    }
    std::printf("\n");
}

int main(int, char **argv) {
    sf_config config;
    config.response_time = 0.5;
    config.thrust_x = 5;
    config.thrust_y = 3;
    config.sample_us = 20000;
    sf_init(&flow, &config);
    FILE *file = std::fopen(argv[1], "r");
    char line[512];
    double t, x, y, vx, vy;
    for (long sample = 0; std::fgets(line, 512, file);) {
        if (std::sscanf(line, "%lf,%lf,%lf,%lf,%lf", &t, &x, &y, &vx, &vy) < 5) continue;
        show("before");
        sf_update(&flow, static_cast<uint64_t>(std::llround(t * 1e6)), x, y, vx, vy);
        show("update");
        if (++sample % 100 == 0) {
            sf_answer answer;
            sf_estimate(&flow, &answer);
            show("estimate");
        }
    }
    std::fclose(file);
}
