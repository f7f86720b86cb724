#include "covinz/upright_relative_pose.h"

#include <algorithm>
#include <cmath>

#include <Eigen/QR>

#include "covinz/polynomial.h"

namespace covinz {
namespace {

// Translations beyond are those of matches that do not determine them [m].
constexpr double kLongest_m = 1e6;

using Quadratic = std::array<double, 3>;  // ascending
using Quartic = std::array<double, 5>;
using PolynomialMatrix = std::array<std::array<Quadratic, 4>, 4>;

// (1 + s^2) times v, turned about z by 2 atan(s).
std::array<Quadratic, 3> Turned(const Eigen::Vector3d& v) {
  return {Quadratic{v.x(), -2.0 * v.y(), -v.x()}, Quadratic{v.y(), 2.0 * v.x(), -v.y()},
          Quadratic{v.z(), 0.0, v.z()}};
}

void AddScaled(const Quadratic& a, double factor, Quadratic& sum) {
  for (size_t i = 0; i < 3; ++i) sum[i] += factor * a[i];
}

// One row of M(s), of rays and moments with z vertical.
std::array<Quadratic, 4> Row(const Eigen::Vector3d& query_ray,
                             const Eigen::Vector3d& query_moment,
                             const Eigen::Vector3d& cand_ray,
                             const Eigen::Vector3d& cand_moment) {
  const std::array<Quadratic, 3> ray = Turned(query_ray);
  const std::array<Quadratic, 3> moment = Turned(query_moment);
  std::array<Quadratic, 4> row{};
  for (size_t k = 0; k < 3; ++k) {
    const size_t a = (k + 1) % 3;
    const size_t b = (k + 2) % 3;
    AddScaled(ray[a], cand_ray[static_cast<int>(b)], row[k]);
    AddScaled(ray[b], -cand_ray[static_cast<int>(a)], row[k]);
    AddScaled(moment[k], cand_ray[static_cast<int>(k)], row[3]);
    AddScaled(ray[k], cand_moment[static_cast<int>(k)], row[3]);
  }
  return row;
}

// Of two rows and the columns i, j.
Quartic Minor(const PolynomialMatrix& M, size_t row, size_t i, size_t j) {
  Quartic minor{};
  for (size_t a = 0; a < 3; ++a) {
    for (size_t b = 0; b < 3; ++b) {
      minor[a + b] += M[row][i][a] * M[row + 1][j][b] - M[row][j][a] * M[row + 1][i][b];
    }
  }
  return minor;
}

// Laplace's expansion along the first two rows.
std::vector<double> Determinant(const PolynomialMatrix& M) {
  constexpr size_t kColumns[6][4] = {{0, 1, 2, 3}, {2, 0, 1, 3}, {0, 3, 1, 2},
                                     {1, 2, 0, 3}, {3, 1, 0, 2}, {2, 3, 0, 1}};  // even orders
  std::vector<double> determinant(9, 0.0);
  for (const auto& columns : kColumns) {
    const Quartic first = Minor(M, 0, columns[0], columns[1]);
    const Quartic second = Minor(M, 2, columns[2], columns[3]);
    for (size_t a = 0; a < 5; ++a) {
      for (size_t b = 0; b < 5; ++b) determinant[a + b] += first[a] * second[b];
    }
  }
  return determinant;
}

Eigen::Matrix4d Evaluate(const PolynomialMatrix& M, double s) {
  Eigen::Matrix4d value;
  for (size_t row = 0; row < 4; ++row) {
    for (size_t col = 0; col < 4; ++col) {
      const Quadratic& entry = M[row][col];
      // Over 1 + s^2, for large s as well.
      value(static_cast<int>(row), static_cast<int>(col)) =
          (entry[0] + s * (entry[1] + s * entry[2])) / (1.0 + s * s);
    }
  }
  return value;
}

bool AllInFront(const std::array<RayMatch, 4>& matches,
                const Eigen::Isometry3d& T_cand_query,
                double parallel_rad) {
  return std::all_of(matches.begin(), matches.end(), [&](const RayMatch& m) {
    return MeetInFront(T_cand_query.linear() * m.query_ray, m.cand_ray,
                       T_cand_query * m.query_centre - m.cand_centre, parallel_rad);
  });
}

}  // namespace

std::vector<Eigen::Isometry3d> SolveUprightFourPoint(const std::array<RayMatch, 4>& matches,
                                                     const Verticals& verticals,
                                                     double parallel_rad) {
  const Eigen::Vector3d z = Eigen::Vector3d::UnitZ();
  const Eigen::Matrix3d R_upright_query =
      Eigen::Quaterniond::FromTwoVectors(verticals.query, z).toRotationMatrix();
  const Eigen::Matrix3d R_upright_cand =
      Eigen::Quaterniond::FromTwoVectors(verticals.cand, z).toRotationMatrix();
  PolynomialMatrix M;
  for (size_t i = 0; i < 4; ++i) {
    const RayMatch& m = matches[i];
    M[i] = Row(R_upright_query * m.query_ray, R_upright_query * m.query_centre.cross(m.query_ray),
               R_upright_cand * m.cand_ray, R_upright_cand * m.cand_centre.cross(m.cand_ray));
  }
  std::vector<Eigen::Isometry3d> poses;
  for (const double s : RealRoots(Determinant(M))) {
    const Eigen::Matrix4d M_s = Evaluate(M, s);
    const Eigen::Vector3d t = -M_s.leftCols<3>().colPivHouseholderQr().solve(M_s.col(3));
    if (!(t.norm() < kLongest_m)) continue;
    Eigen::Isometry3d T_cand_query = Eigen::Isometry3d::Identity();
    T_cand_query.linear() = R_upright_cand.transpose() *
                            Eigen::AngleAxisd(2.0 * std::atan(s), z).toRotationMatrix() *
                            R_upright_query;
    T_cand_query.translation() = R_upright_cand.transpose() * t;
    if (AllInFront(matches, T_cand_query, parallel_rad)) poses.push_back(T_cand_query);
  }
  return poses;
}

}  // namespace covinz
