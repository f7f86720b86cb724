#include "covinz/polynomial.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace covinz {
namespace {

constexpr int kMaxDegree = 16;
// Remainders this small against their dividend are rounding errors: the chain ends there.
constexpr double kNegligible = 1e-13;
constexpr int kMaxBisections = 50;
constexpr int kMaxPolishings = 60;
// Newton's steps square the error, so this one was the last that mattered.
constexpr double kConvergedStep = 1e-10;

struct Polynomial {
  std::array<double, kMaxDegree + 1> c{};  // c[i] x^i
  int degree = -1;                         // -1 is zero

  double operator()(double x) const {
    double value = 0.0;
    for (int i = degree; i >= 0; --i) value = value * x + c[static_cast<size_t>(i)];
    return value;
  }
};

Polynomial Derivative(const Polynomial& p) {
  Polynomial derivative;
  derivative.degree = p.degree - 1;
  for (int i = 1; i <= p.degree; ++i) {
    derivative.c[static_cast<size_t>(i - 1)] = i * p.c[static_cast<size_t>(i)];
  }
  return derivative;
}

// Scales to a largest coefficient of one; leading coefficients below the limit count as zero.
void Normalize(double limit, Polynomial& p) {
  double largest = 0.0;
  for (int i = 0; i <= p.degree; ++i) {
    largest = std::max(largest, std::abs(p.c[static_cast<size_t>(i)]));
  }
  if (!(largest > limit)) {
    p.degree = -1;
    return;
  }
  const double scale = 1.0 / largest;
  for (int i = 0; i <= p.degree; ++i) p.c[static_cast<size_t>(i)] *= scale;
  while (std::abs(p.c[static_cast<size_t>(p.degree)]) < kNegligible) --p.degree;
}

Polynomial NegativeRemainder(Polynomial dividend, const Polynomial& divisor) {
  const double leading = divisor.c[static_cast<size_t>(divisor.degree)];
  while (dividend.degree >= divisor.degree) {
    const double factor = dividend.c[static_cast<size_t>(dividend.degree)] / leading;
    const int shift = dividend.degree - divisor.degree;
    for (int i = 0; i < divisor.degree; ++i) {
      dividend.c[static_cast<size_t>(i + shift)] -= factor * divisor.c[static_cast<size_t>(i)];
    }
    --dividend.degree;
  }
  for (int i = 0; i <= dividend.degree; ++i) {
    dividend.c[static_cast<size_t>(i)] = -dividend.c[static_cast<size_t>(i)];
  }
  return dividend;
}

class SturmChain {
 public:
  explicit SturmChain(const Polynomial& p) {
    chain_[0] = p;
    chain_[1] = Derivative(p);
    Normalize(0.0, chain_[1]);
    length_ = 2;
    while (chain_[length_ - 1].degree > 0) {
      chain_[length_] = NegativeRemainder(chain_[length_ - 2], chain_[length_ - 1]);
      Normalize(kNegligible, chain_[length_]);
      if (chain_[length_].degree < 0) break;
      ++length_;
    }
  }

  // The number of roots in (a, b] is SignChanges(a) - SignChanges(b).
  int SignChanges(double x) const {
    int changes = 0;
    double last = 0.0;
    for (size_t i = 0; i < length_; ++i) {
      const double value = chain_[i](x);
      if (value == 0.0) continue;
      if (last * value < 0.0) ++changes;
      last = std::copysign(1.0, value);
    }
    return changes;
  }

  const Polynomial& polynomial() const { return chain_[0]; }

 private:
  std::array<Polynomial, kMaxDegree + 1> chain_;
  size_t length_;
};

// The one root in (low, high].
double Polish(const SturmChain& chain, double low, double high) {
  const Polynomial& p = chain.polynomial();
  const Polynomial derivative = Derivative(p);
  const double sign_high = std::copysign(1.0, p(high));
  double x = 0.5 * (low + high);
  for (int i = 0; i < kMaxPolishings; ++i) {
    const double value = p(x);
    (value * sign_high > 0.0 ? high : low) = x;
    double next = x - value / derivative(x);
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (std::abs(next - x) < kConvergedStep) return next;
    x = next;
  }
  return x;
}

struct Interval {
  double low, high;
  int changes_low, changes_high;
  int depth;
};

void RootsWithinOne(const Polynomial& p, bool inverse, std::vector<double>& roots) {
  if (p.degree < 1) return;
  const SturmChain chain(p);
  std::vector<Interval> open;
  open.reserve(kMaxDegree);
  open.push_back({-1.0, 1.0, chain.SignChanges(-1.0), chain.SignChanges(1.0), 0});
  while (!open.empty()) {
    const Interval interval = open.back();
    open.pop_back();
    const int num_roots = interval.changes_low - interval.changes_high;
    if (num_roots < 1) continue;
    const double middle = 0.5 * (interval.low + interval.high);
    if (num_roots == 1 || interval.depth == kMaxBisections) {
      const double root = Polish(chain, interval.low, interval.high);
      if (!inverse) roots.push_back(root);
      if (inverse && std::abs(root) < 1.0 && root != 0.0) roots.push_back(1.0 / root);
      continue;
    }
    const int changes = chain.SignChanges(middle);
    open.push_back({interval.low, middle, interval.changes_low, changes, interval.depth + 1});
    open.push_back({middle, interval.high, changes, interval.changes_high, interval.depth + 1});
  }
}

}  // namespace

std::vector<double> RealRoots(const std::vector<double>& coefficients) {
  std::vector<double> roots;
  if (coefficients.size() > kMaxDegree + 1) return roots;
  Polynomial p;
  p.degree = static_cast<int>(coefficients.size()) - 1;
  for (size_t i = 0; i < coefficients.size(); ++i) {
    if (!std::isfinite(coefficients[i])) return roots;
    p.c[i] = coefficients[i];
  }
  while (p.degree >= 0 && p.c[static_cast<size_t>(p.degree)] == 0.0) --p.degree;
  if (p.degree < 1) return roots;
  Polynomial reversed = p;
  std::reverse(reversed.c.begin(), reversed.c.begin() + p.degree + 1);
  Normalize(0.0, p);
  Normalize(0.0, reversed);
  RootsWithinOne(p, false, roots);
  RootsWithinOne(reversed, true, roots);
  return roots;
}

}  // namespace covinz
