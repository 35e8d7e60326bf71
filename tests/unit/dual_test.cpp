#include "stages/core/math/dual.h"

#include <gtest/gtest.h>

#include "stages/core/math/vector.h"

namespace loom {
namespace {

using D = Dual<2, double>;

/// f(x, y) with its two derivatives against central differences. Detected mutation: the sign in the derivative of a
/// quotient.
template <class F>
void expect_derivatives(const char* name, F&& f, double x, double y) {
    const D dual = f(D::variable(x, 0), D::variable(y, 1));
    const double h = 1e-6;
    EXPECT_DOUBLE_EQ(dual.value, f(x, y)) << name;
    EXPECT_NEAR(dual.d[0], (f(x + h, y) - f(x - h, y)) / (2 * h), 1e-7 * (1 + std::abs(dual.d[0]))) << name;
    EXPECT_NEAR(dual.d[1], (f(x, y + h) - f(x, y - h)) / (2 * h), 1e-7 * (1 + std::abs(dual.d[1]))) << name;
}

TEST(Dual, DerivativesOfEveryFunction) {
    using std::abs, std::acos, std::asin, std::atan, std::atan2, std::cos, std::erf, std::exp, std::fabs, std::log,
        std::pow, std::sin, std::sqrt, std::tan;
    for (const auto& [x, y] : {std::pair{0.3, 0.7}, {0.9, 0.2}, {0.4, 0.5}}) {
        expect_derivatives(
            "+ - * /", [](auto a, auto b) { return (a + b) * (a - 2.0 * b) / (b + a * a) - a; }, x, y);
        expect_derivatives(
            "assignments",
            [](auto a, auto b) {
                auto c = a;
                c += b;
                c *= a;
                c -= b;
                c /= b;
                return -c;
            },
            x, y);
        expect_derivatives(
            "sqrt", [](auto a, auto b) { return sqrt(a * b); }, x, y);
        expect_derivatives(
            "exp log", [](auto a, auto b) { return exp(a * b) + log(a + b); }, x, y);
        expect_derivatives(
            "sin cos tan", [](auto a, auto b) { return sin(a * b) * cos(a - b) + tan(a); }, x, y);
        expect_derivatives(
            "acos asin", [](auto a, auto b) { return acos(a * b) + asin(b) * a; }, x, y);
        expect_derivatives(
            "atan atan2", [](auto a, auto b) { return atan(a) * atan2(-b, -a); }, x, y);
        expect_derivatives(
            "erf", [](auto a, auto b) { return erf(a * b); }, x, y);
        expect_derivatives(
            "pow", [](auto a, auto b) { return pow(a, b); }, x, y);
        expect_derivatives(
            "fabs", [](auto a, auto b) { return fabs(a - 2.0 * b) + abs(b); }, x, y);
        expect_derivatives(
            "select", [](auto a, auto b) { return select(a > b, a * b, a + b) + clamp(a, b * 0.0, b * 0.0 + 0.8); }, x,
            y);
    }
}

TEST(Dual, TheSideNotTakenLeavesNoTrace) {
    const D x = D::variable(0, 0);
    EXPECT_TRUE(isfinite(sqrt(x)));
    EXPECT_TRUE(isfinite(safe_sqrt(x - 1.0)));
    EXPECT_TRUE(isfinite(acos(x + 1.0)));
    EXPECT_TRUE(isfinite(atan2(x, x)));
    EXPECT_TRUE(isfinite(select(x > D(0), log(x), x)));
    EXPECT_TRUE(isfinite(pow(x, D(2))));
}

TEST(Dual, NanStaysNan) {
    EXPECT_FALSE(isfinite(sqrt(D(-1))));
    EXPECT_FALSE(isfinite(D(0) / D(0)));
}

TEST(Dual, ComparesByValueAndMixesWithPlainNumbers) {
    const D a = D::variable(1, 0), b = D::variable(1, 1);
    EXPECT_TRUE(a == b && a <= b && a < 2 && 0.5f < a);
    EXPECT_EQ((2 * a + 1).d[0], 2);
    EXPECT_EQ(value_of(a), 1);
    EXPECT_EQ(value_of(3.5f), 3.5f);
    const Vector3<D> v = normalize(Vector3<D>{a, b, D(1)});
    EXPECT_NEAR(v.x.d[0] + v.x.d[1], std::pow(3, -1.5), 1e-12);  // d/ds s / sqrt(2 s² + 1) at 1
}

}  // namespace
}  // namespace loom
