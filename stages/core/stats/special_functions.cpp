#include "stages/core/stats/special_functions.h"

#include <boost/math/special_functions/beta.hpp>
#include <boost/math/special_functions/gamma.hpp>

namespace loom {
namespace {

using namespace boost::math::policies;
/// Policy: returns the limit or NaN where Boost throws by default; doubles are precise enough without long doubles.
using Limits = policy<domain_error<ignore_error>, pole_error<ignore_error>, overflow_error<ignore_error>,
                      evaluation_error<ignore_error>, promote_double<false>>;

}  // namespace

double regularized_gamma_q(double a, double x) {
    return x <= 0 ? 1 : boost::math::gamma_q(a, x, Limits());
}

double incomplete_beta(double a, double b, double x) {
    return x <= 0 ? 0 : x >= 1 ? 1 : boost::math::ibeta(a, b, x, Limits());
}

}  // namespace loom
