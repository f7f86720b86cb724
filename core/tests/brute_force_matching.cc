// MatchDescriptors by its definition, for builds of the tests of rig_matching.h that have no
// OpenCV: those for other processors (scripts/neon_tests.sh).
#include <cmath>
#include <stdexcept>

#include "covinz/matching.h"

namespace covinz {
namespace {

// As OpenCV gives it.
double Distance(const Descriptors& a,
                Eigen::Index i,
                const Descriptors& b,
                Eigen::Index j,
                DescriptorNorm norm) {
  int sum = 0;
  for (Eigen::Index k = 0; k < a.cols(); ++k) {
    const int x = a(i, k);
    const int y = b(j, k);
    sum += norm == DescriptorNorm::kHamming ? __builtin_popcount(static_cast<unsigned>(x ^ y))
                                            : (x - y) * (x - y);
  }
  const float value = static_cast<float>(sum);
  return norm == DescriptorNorm::kHamming ? value : std::sqrt(value);
}

Eigen::MatrixXd Distances(const Descriptors& query, const Descriptors& cand, DescriptorNorm norm) {
  return Eigen::MatrixXd::NullaryExpr(
      query.rows(), cand.rows(),
      [&](Eigen::Index q, Eigen::Index c) { return Distance(query, q, cand, c, norm); });
}

}  // namespace

void MatchingOptions::Check() const {
  if (!(max_ratio > 0.0 && max_ratio <= 1.0 && max_distance >= 0.0)) {
    throw std::invalid_argument("MatchingOptions out of range");
  }
}

std::vector<Match> MatchDescriptors(const Descriptors& query,
                                    const Descriptors& cand,
                                    const MatchingOptions& options) {
  options.Check();
  if (query.rows() == 0 || cand.rows() == 0) return {};
  if (query.cols() != cand.cols()) throw std::invalid_argument("descriptors differ in length");
  const Eigen::MatrixXd distances = Distances(query, cand, options.norm);
  std::vector<Match> matches;
  for (Eigen::Index q = 0; q < query.rows(); ++q) {
    Eigen::VectorXd row = distances.row(q);
    Eigen::Index c = 0;
    Eigen::Index back = 0;
    const double best = row.minCoeff(&c);
    row(c) = INFINITY;
    const double second = row.minCoeff();
    distances.col(c).minCoeff(&back);
    if (best > options.max_distance) continue;
    if (options.max_ratio < 1.0 && !(std::isfinite(second) && best < options.max_ratio * second)) {
      continue;
    }
    if (!options.mutual || back == q) matches.push_back({static_cast<int>(q), static_cast<int>(c)});
  }
  return matches;
}

}  // namespace covinz
