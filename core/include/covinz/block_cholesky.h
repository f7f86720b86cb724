// Cholesky factorisation of large sparse symmetric matrices made of 6x6 blocks, as pose graphs
// have them: one row and column of blocks per pose, one block per pair of poses with an edge.
#pragma once

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "covinz/instruction_set.h"
#include "covinz/se3.h"

namespace covinz {

// The diagonal blocks and those below the diagonal that may differ from zero.
struct SymmetricBlockMatrix {
  // Places of the blocks below the diagonal: (column, row), column < row, sorted, no two equal.
  std::vector<std::pair<int32_t, int32_t>> pairs;
  std::vector<Matrix6d> diagonal;  // one per row of blocks; lower triangles are read
  std::vector<Matrix6d> below;     // one per pair

  // Throws std::invalid_argument where sizes or pairs are not as above.
  void Check() const;
};

// What the factorisation of one structure costs.
struct CholeskyCost {
  int64_t num_nonzeros = 0;  // of the factor's supernodes, explicit zeros included
  int64_t num_flops = 0;     // multiplications and additions
  int num_supernodes = 0;
};

// L L^T = P A P^T for matrices A of one structure: the permutation P, the structure of L and all
// addresses are found once, and many matrices of that structure factorised.
//
// The blocks are ordered by approximate minimum degree; columns of like structure form
// supernodes, dense panels, and a supernode is merged into the next one where the zeros that this
// fills in cost less than the smaller panels would. Each panel is factorised densely and its
// outer product subtracted from the panels to its right. One thread; the same matrix gives the
// same bits on the same instruction set.
//
// Source: Amestoy, Davis and Duff, "An approximate minimum degree ordering algorithm", 1996; Liu,
// "The role of elimination trees in sparse factorization", 1990; Ng and Peyton, "Block sparse
// Cholesky algorithms on advanced uniprocessor computers", 1993; Ashcraft and Grimes, "The
// influence of relaxed supernode partitions on the multifrontal method", 1989.
class BlockCholesky {
 public:
  // For matrices with the pairs of `structure`; its blocks are not read. Throws
  // std::invalid_argument where it is malformed or this processor has no such instructions.
  explicit BlockCholesky(const SymmetricBlockMatrix& structure,
                         InstructionSet instruction_set = BestInstructionSet());
  ~BlockCholesky();
  BlockCholesky(BlockCholesky&&) noexcept;
  BlockCholesky& operator=(BlockCholesky&&) noexcept;

  // Factorises A, of the constructor's structure, plus a diagonal matrix (six entries per block).
  // False, and no factor, when the sum is not numerically positive definite or not finite.
  bool Factorize(const SymmetricBlockMatrix& A, const Eigen::VectorXd& diagonal);

  // x of A x = b, by the last factor. Throws std::logic_error without one.
  Eigen::VectorXd Solve(const Eigen::VectorXd& b) const;

  CholeskyCost Cost() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace covinz
