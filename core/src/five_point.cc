#include "covinz/five_point.h"

#include <cmath>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/QR>

#include "covinz/polynomial.h"

namespace covinz {
namespace {

// Polynomials in x, y, z by their coefficients.
using Linear = std::array<double, 4>;      // x, y, z, 1
using Quadratic = std::array<double, 10>;  // x2, xy, xz, x, y2, yz, y, z2, z, 1
// Nister's order: x3, y3, x2y, xy2, x2z, x2, y2z, y2, xyz, xy | xz2, xz, x, yz2, yz, y, z3, z2, z,
// 1
using Cubic = std::array<double, 20>;

constexpr size_t kLinearTimesLinear[4][4] = {
    {0, 1, 2, 3}, {1, 4, 5, 6}, {2, 5, 7, 8}, {3, 6, 8, 9}};
constexpr size_t kQuadraticTimesLinear[10][4] = {
    {0, 2, 4, 5},   {2, 3, 8, 9},   {4, 8, 10, 11},   {5, 9, 11, 12},   {3, 1, 6, 7},
    {8, 6, 13, 14}, {9, 7, 14, 15}, {10, 13, 16, 17}, {11, 14, 17, 18}, {12, 15, 18, 19}};

void AddProduct(const Linear& a, const Linear& b, double factor, Quadratic& sum) {
  for (size_t i = 0; i < 4; ++i) {
    for (size_t j = 0; j < 4; ++j) sum[kLinearTimesLinear[i][j]] += factor * a[i] * b[j];
  }
}

void AddProduct(const Quadratic& a, const Linear& b, Cubic& sum) {
  for (size_t i = 0; i < 10; ++i) {
    for (size_t j = 0; j < 4; ++j) sum[kQuadraticTimesLinear[i][j]] += a[i] * b[j];
  }
}

using NullSpace = std::array<Eigen::Matrix3d, 4>;  // X, Y, Z, W
using Entries = std::array<std::array<Linear, 3>, 3>;
using Constraints = Eigen::Matrix<double, 10, 20>;

NullSpace EpipolarNullSpace(const std::array<Eigen::Vector3d, 5>& query,
                            const std::array<Eigen::Vector3d, 5>& cand) {
  Eigen::Matrix<double, 9, 5> epipolar;  // columns vec(cand query^T)
  for (int i = 0; i < 5; ++i) {
    const Eigen::Matrix3d outer =
        cand[static_cast<size_t>(i)] * query[static_cast<size_t>(i)].transpose();
    epipolar.col(i) = Eigen::Map<const Eigen::Matrix<double, 9, 1>>(outer.data());
  }
  const Eigen::HouseholderQR<Eigen::Matrix<double, 9, 5>> qr(epipolar);
  Eigen::Matrix<double, 9, 4> last = Eigen::Matrix<double, 9, 4>::Zero();
  last.bottomRows<4>().setIdentity();
  last.applyOnTheLeft(qr.householderQ());
  NullSpace basis;
  for (int i = 0; i < 4; ++i) {
    basis[static_cast<size_t>(i)] = Eigen::Map<const Eigen::Matrix3d>(last.col(i).data());
  }
  return basis;
}

Entries EntriesOf(const NullSpace& basis) {
  Entries E;
  for (size_t r = 0; r < 3; ++r) {
    for (size_t c = 0; c < 3; ++c) {
      for (size_t k = 0; k < 4; ++k)
        E[r][c][k] = basis[k](static_cast<int>(r), static_cast<int>(c));
    }
  }
  return E;
}

// det E = 0, expanded along the first row.
Cubic Determinant(const Entries& E) {
  Cubic determinant{};
  for (size_t c = 0; c < 3; ++c) {
    const size_t a = (c + 1) % 3;
    const size_t b = (c + 2) % 3;
    Quadratic minor{};
    AddProduct(E[1][a], E[2][b], 1.0, minor);
    AddProduct(E[1][b], E[2][a], -1.0, minor);
    AddProduct(minor, E[0][c], determinant);
  }
  return determinant;
}

// (E E^T - tr(E E^T) / 2) E = 0 and det E = 0.
Constraints CubicConstraints(const Entries& E) {
  std::array<std::array<Quadratic, 3>, 3> EEt{};
  for (size_t r = 0; r < 3; ++r) {
    for (size_t c = r; c < 3; ++c) {
      for (size_t k = 0; k < 3; ++k) AddProduct(E[r][k], E[c][k], 1.0, EEt[r][c]);
      EEt[c][r] = EEt[r][c];
    }
  }
  for (size_t i = 0; i < 10; ++i) {
    const double half_trace = 0.5 * (EEt[0][0][i] + EEt[1][1][i] + EEt[2][2][i]);
    for (size_t k = 0; k < 3; ++k) EEt[k][k][i] -= half_trace;
  }
  Constraints constraints;
  constraints.row(9) = Eigen::Map<const Eigen::RowVectorXd>(Determinant(E).data(), 20);
  for (size_t r = 0; r < 3; ++r) {
    for (size_t c = 0; c < 3; ++c) {
      Cubic cubic{};
      for (size_t k = 0; k < 3; ++k) AddProduct(EEt[r][k], E[k][c], cubic);
      constraints.row(static_cast<int>(3 * r + c)) =
          Eigen::Map<const Eigen::RowVectorXd>(cubic.data(), 20);
    }
  }
  return constraints;
}

using Univariate = std::array<double, 5>;  // in z, ascending, at most quartic

// B(z) (x, y, 1)^T = 0 with polynomial entries.
using PolynomialMatrix = std::array<std::array<Univariate, 3>, 3>;

// Row a - z * row b, where a leads with a monomial that is z times that of b.
void Eliminate(const Eigen::Matrix<double, 10, 10>& rest,
               int a,
               int b,
               std::array<Univariate, 3>& row) {
  for (size_t k = 0; k < 2; ++k) {  // coefficients of x and of y
    const int first = 3 * static_cast<int>(k);
    row[k] = {rest(a, first + 2), rest(a, first + 1) - rest(b, first + 2),
              rest(a, first) - rest(b, first + 1), -rest(b, first), 0.0};
  }
  row[2] = {rest(a, 9), rest(a, 8) - rest(b, 9), rest(a, 7) - rest(b, 8), rest(a, 6) - rest(b, 7),
            -rest(b, 6)};
}

std::vector<double> DeterminantPolynomial(const PolynomialMatrix& B) {
  std::vector<double> determinant(11, 0.0);
  for (size_t r = 0; r < 3; ++r) {
    const size_t a = (r + 1) % 3;
    const size_t b = (r + 2) % 3;
    std::array<double, 7> minor{};  // of the columns of x and y
    for (size_t i = 0; i < 4; ++i) {
      for (size_t j = 0; j < 4; ++j)
        minor[i + j] += B[a][0][i] * B[b][1][j] - B[b][0][i] * B[a][1][j];
    }
    for (size_t i = 0; i < 7; ++i) {
      for (size_t j = 0; j < 5; ++j) determinant[i + j] += minor[i] * B[r][2][j];
    }
  }
  return determinant;
}

Eigen::Matrix3d Evaluate(const PolynomialMatrix& B, double z) {
  Eigen::Matrix3d value;
  for (size_t r = 0; r < 3; ++r) {
    for (size_t c = 0; c < 3; ++c) {
      double sum = 0.0;
      for (size_t i = 5; i-- > 0;) sum = sum * z + B[r][c][i];
      value(static_cast<int>(r), static_cast<int>(c)) = sum;
    }
  }
  return value;
}

// The longest cross product of two rows of a matrix of rank two.
Eigen::Vector3d NullVector(const Eigen::Matrix3d& matrix) {
  Eigen::Vector3d best = Eigen::Vector3d::Zero();
  for (int r = 0; r < 3; ++r) {
    const Eigen::Vector3d cross = matrix.row(r).cross(matrix.row((r + 1) % 3));
    if (cross.squaredNorm() > best.squaredNorm()) best = cross;
  }
  return best;
}

}  // namespace

std::vector<Eigen::Matrix3d> FivePointEssentialMatrices(
    const std::array<Eigen::Vector3d, 5>& query, const std::array<Eigen::Vector3d, 5>& cand) {
  const NullSpace basis = EpipolarNullSpace(query, cand);
  const Constraints constraints = CubicConstraints(EntriesOf(basis));
  const Eigen::Matrix<double, 10, 10> rest =
      constraints.leftCols<10>().partialPivLu().solve(constraints.rightCols<10>());
  std::vector<Eigen::Matrix3d> essentials;
  if (!rest.allFinite()) return essentials;
  PolynomialMatrix B{};
  for (int k = 0; k < 3; ++k) Eliminate(rest, 4 + 2 * k, 5 + 2 * k, B[static_cast<size_t>(k)]);
  for (const double z : RealRoots(DeterminantPolynomial(B))) {
    const Eigen::Vector3d xy1 = NullVector(Evaluate(B, z));
    // Scaled by xy1.z(), which may be close to zero.
    const Eigen::Matrix3d E =
        xy1.x() * basis[0] + xy1.y() * basis[1] + xy1.z() * (z * basis[2] + basis[3]);
    const double norm = E.norm();
    if (std::isfinite(norm) && norm > 0.0) essentials.emplace_back(E / norm);
  }
  return essentials;
}

}  // namespace covinz
