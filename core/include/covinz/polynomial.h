// Real roots of polynomials in one variable.
#pragma once

#include <vector>

namespace covinz {

// Real roots of sum_i coefficients[i] x^i, each once, in no particular order; none for a constant
// or coefficients that are not finite. Roots of even multiplicity may be missed.
//
// Roots within [-1, 1] are those of the polynomial, the others the inverses of those of the
// reversed polynomial, so that no power overflows. They are isolated by Sturm's theorem and
// polished by Newton's method, safeguarded by bisection.
//
// Source: Hook, McAree, "Using Sturm sequences to bracket real roots of polynomial equations",
// Graphics Gems, 1990.
std::vector<double> RealRoots(const std::vector<double>& coefficients);

}  // namespace covinz
