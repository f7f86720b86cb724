// Sparse block Cholesky factorisation against Eigen's dense one.
#include "covinz/block_cholesky.h"

#include <algorithm>
#include <limits>
#include <random>
#include <set>
#include <stdexcept>

#include <gtest/gtest.h>
#include <Eigen/Cholesky>

#include "pose_graph_problem.h"

namespace covinz {
namespace {

using Pairs = std::vector<std::pair<int32_t, int32_t>>;

constexpr InstructionSet kAll[] = {InstructionSet::kPortable, InstructionSet::kNeon,
                                   InstructionSet::kSse42, InstructionSet::kAvx2,
                                   InstructionSet::kAvx512};

// Random blocks; the diagonal ones outweigh the others in their row, so that it is positive
// definite, and only their lower triangles are set.
SymmetricBlockMatrix RandomMatrix(int32_t num_blocks, const Pairs& pairs, uint64_t seed) {
  Gaussian gaussian(seed);
  SymmetricBlockMatrix A;
  A.pairs = pairs;
  A.diagonal.assign(static_cast<size_t>(num_blocks), Matrix6d::Zero());
  for (const auto& [column, row] : pairs) {
    Matrix6d block;
    for (double& entry : block.reshaped()) entry = gaussian.Draw();
    A.below.push_back(block);
    for (const int32_t i : {column, row}) {
      A.diagonal[static_cast<size_t>(i)].diagonal().array() += 6.0 * block.cwiseAbs().maxCoeff();
    }
  }
  for (Matrix6d& block : A.diagonal) {
    for (int c = 0; c < 6; ++c) {
      block(c, c) += 10.0;
      for (int r = c + 1; r < 6; ++r) block(r, c) = gaussian.Draw();
    }
    block.triangularView<Eigen::StrictlyUpper>().setConstant(
        std::numeric_limits<double>::quiet_NaN());
  }
  return A;
}

Eigen::MatrixXd Dense(const SymmetricBlockMatrix& A) {
  const auto n = static_cast<Eigen::Index>(6 * A.diagonal.size());
  Eigen::MatrixXd dense = Eigen::MatrixXd::Zero(n, n);
  for (size_t i = 0; i < A.diagonal.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(6 * i);
    dense.block<6, 6>(at, at) = A.diagonal[i].selfadjointView<Eigen::Lower>();
  }
  for (size_t k = 0; k < A.pairs.size(); ++k) {
    const auto& [column, row] = A.pairs[k];
    dense.block<6, 6>(6 * row, 6 * column) = A.below[k];
    dense.block<6, 6>(6 * column, 6 * row) = A.below[k].transpose();
  }
  return dense;
}

Eigen::VectorXd RandomVector(Eigen::Index size, uint64_t seed) {
  Gaussian gaussian(seed);
  Eigen::VectorXd x(size);
  for (double& entry : x) entry = gaussian.Draw();
  return x;
}

// Each pair of blocks with this probability.
Pairs RandomPairs(int32_t num_blocks, double density, uint64_t seed) {
  std::mt19937_64 engine(seed);
  Pairs pairs;
  for (int32_t column = 0; column < num_blocks; ++column) {
    for (int32_t row = column + 1; row < num_blocks; ++row) {
      if (static_cast<double>(engine() >> 11) * 0x1p-53 < density) pairs.emplace_back(column, row);
    }
  }
  return pairs;
}

// A chain in which each block is joined to its predecessors, and random loops.
Pairs GraphPairs(int32_t num_blocks, int32_t num_neighbours, int num_loops, uint64_t seed) {
  std::mt19937_64 engine(seed);
  std::set<std::pair<int32_t, int32_t>> pairs;
  for (int32_t row = 0; row < num_blocks; ++row) {
    for (int32_t k = std::max(0, row - num_neighbours); k < row; ++k) pairs.emplace(k, row);
  }
  for (int k = 0; k < num_loops; ++k) {
    const auto a = static_cast<int32_t>(engine() % static_cast<uint64_t>(num_blocks));
    const auto b = static_cast<int32_t>(engine() % static_cast<uint64_t>(num_blocks));
    if (a != b) pairs.insert(std::minmax(a, b));
  }
  return {pairs.begin(), pairs.end()};
}

// Largest difference from the dense solution, on every instruction set that there is.
void ExpectDenseSolution(int32_t num_blocks, const Pairs& pairs, uint64_t seed) {
  const SymmetricBlockMatrix A = RandomMatrix(num_blocks, pairs, seed);
  const Eigen::VectorXd damping = RandomVector(6 * num_blocks, seed + 1).cwiseAbs();
  const Eigen::VectorXd b = RandomVector(6 * num_blocks, seed + 2);
  Eigen::MatrixXd dense = Dense(A);
  dense.diagonal() += damping;
  const Eigen::VectorXd expected = dense.llt().solve(b);
  for (const InstructionSet instruction_set : kAll) {
    if (!IsSupported(instruction_set)) continue;
    BlockCholesky cholesky(A, instruction_set);
    ASSERT_TRUE(cholesky.Factorize(A, damping));
    const Eigen::VectorXd x = cholesky.Solve(b);
    EXPECT_LT((x - expected).norm(), 1e-12 * expected.norm())
        << num_blocks << " blocks, " << pairs.size() << " pairs, instruction set "
        << static_cast<int>(instruction_set);
    // The same factor from the same memory, whatever was in it.
    ASSERT_TRUE(cholesky.Factorize(A, damping));
    EXPECT_EQ(cholesky.Solve(b), x);
  }
}

TEST(BlockCholesky, SolvesAsTheDenseFactorDoes) {
  uint64_t seed = 1;
  for (const int32_t num_blocks : {1, 2, 3, 7, 20, 45}) {
    for (const double density : {0.0, 0.03, 0.1, 0.4, 1.0}) {
      ExpectDenseSolution(num_blocks, RandomPairs(num_blocks, density, seed), seed);
      ++seed;
    }
  }
}

TEST(BlockCholesky, SolvesPoseGraphs) {
  uint64_t seed = 100;
  for (const int32_t num_neighbours : {1, 4}) {
    for (const int num_loops : {0, 5, 60, 400}) {
      ExpectDenseSolution(120, GraphPairs(120, num_neighbours, num_loops, seed), seed);
      ++seed;
    }
  }
}

TEST(BlockCholesky, SolvesStarsAndSeparateChains) {
  Pairs star;
  for (int32_t row = 1; row < 30; ++row) star.emplace_back(0, row);
  ExpectDenseSolution(30, star, 200);
  Pairs chains;
  for (int32_t row = 1; row < 60; ++row) {
    if (row % 20 != 0) chains.emplace_back(row - 1, row);
  }
  ExpectDenseSolution(60, chains, 201);
}

TEST(BlockCholesky, AChainHasNoFillButThatOfMerging) {
  const SymmetricBlockMatrix chain = RandomMatrix(200, GraphPairs(200, 1, 0, 0), 5);
  const CholeskyCost cost = BlockCholesky(chain).Cost();
  const int64_t least = 200 * 21 + 199 * 36;
  EXPECT_GE(cost.num_nonzeros, least);
  EXPECT_LT(cost.num_nonzeros, 4 * least);
  EXPECT_LT(cost.num_supernodes, 100);  // small panels are merged
}

TEST(BlockCholesky, EmptyMatrix) {
  const SymmetricBlockMatrix empty;
  BlockCholesky cholesky(empty);
  ASSERT_TRUE(cholesky.Factorize(empty, Eigen::VectorXd()));
  EXPECT_EQ(cholesky.Solve(Eigen::VectorXd()).size(), 0);
}

TEST(BlockCholesky, TellsThatAMatrixIsNotPositiveDefinite) {
  const Pairs pairs = GraphPairs(40, 2, 30, 7);
  const SymmetricBlockMatrix good = RandomMatrix(40, pairs, 8);
  const Eigen::VectorXd none = Eigen::VectorXd::Zero(240);
  const Eigen::VectorXd b = RandomVector(240, 9);
  for (const double spoilt :
       {-1e3, -std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(),
        std::numeric_limits<double>::quiet_NaN()}) {
    for (const size_t block : {size_t{0}, size_t{17}, size_t{39}}) {
      BlockCholesky cholesky(good);
      EXPECT_THROW(cholesky.Solve(b), std::logic_error);
      ASSERT_TRUE(cholesky.Factorize(good, none));
      const Eigen::VectorXd x = cholesky.Solve(b);
      SymmetricBlockMatrix bad = good;
      bad.diagonal[block](3, 3) = spoilt;
      EXPECT_FALSE(cholesky.Factorize(bad, none)) << spoilt << " in block " << block;
      EXPECT_THROW(cholesky.Solve(b), std::logic_error);
      ASSERT_TRUE(cholesky.Factorize(good, none));
      EXPECT_EQ(cholesky.Solve(b), x);
    }
  }
}

TEST(BlockCholesky, SingularMatrixIsNoMatrixToSolve) {
  SymmetricBlockMatrix A = RandomMatrix(3, {{0, 1}, {1, 2}}, 10);
  A.diagonal[1].setZero();
  BlockCholesky cholesky(A);
  EXPECT_FALSE(cholesky.Factorize(A, Eigen::VectorXd::Zero(18)));
}

TEST(BlockCholesky, MalformedInputIsRejected) {
  const SymmetricBlockMatrix good = RandomMatrix(3, {{0, 1}, {1, 2}}, 11);
  const auto expect_rejected = [&](const auto& spoil) {
    SymmetricBlockMatrix bad = good;
    spoil(bad);
    EXPECT_THROW(BlockCholesky{bad}, std::invalid_argument);
  };
  expect_rejected([](SymmetricBlockMatrix& A) { A.below.pop_back(); });
  expect_rejected([](SymmetricBlockMatrix& A) { A.pairs[0] = {1, 1}; });
  expect_rejected([](SymmetricBlockMatrix& A) { A.pairs[0] = {1, 0}; });
  expect_rejected([](SymmetricBlockMatrix& A) { A.pairs[0] = {-1, 1}; });
  expect_rejected([](SymmetricBlockMatrix& A) { A.pairs[1] = {1, 3}; });
  expect_rejected([](SymmetricBlockMatrix& A) { A.pairs[1] = A.pairs[0]; });
  BlockCholesky cholesky(good);
  EXPECT_THROW(cholesky.Factorize(good, Eigen::VectorXd::Zero(12)), std::invalid_argument);
  const SymmetricBlockMatrix other = RandomMatrix(3, {{0, 2}, {1, 2}}, 11);
  EXPECT_THROW(cholesky.Factorize(other, Eigen::VectorXd::Zero(18)), std::invalid_argument);
  ASSERT_TRUE(cholesky.Factorize(good, Eigen::VectorXd::Zero(18)));
  EXPECT_THROW(cholesky.Solve(Eigen::VectorXd::Zero(17)), std::invalid_argument);
}

TEST(BlockCholesky, UnknownInstructionsAreRejected) {
  for (const InstructionSet instruction_set : kAll) {
    if (IsSupported(instruction_set)) continue;
    EXPECT_THROW(BlockCholesky(SymmetricBlockMatrix(), instruction_set), std::invalid_argument);
  }
}

}  // namespace
}  // namespace covinz
