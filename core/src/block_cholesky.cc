// Right-looking supernodal factorisation on the kernels of cholesky_kernels.h.
#include "covinz/block_cholesky.h"

#include <algorithm>
#include <stdexcept>
#include <string>

#include "cholesky_kernels.h"
#include "supernodes.h"

namespace covinz {
namespace {

constexpr size_t kBlock = 6;

const CholeskyKernels& KernelsFor(InstructionSet instruction_set) {
  if (!IsSupported(instruction_set)) {
    throw std::invalid_argument("Cholesky: this processor lacks the instruction set");
  }
  switch (instruction_set) {
    case InstructionSet::kAvx512:
      return kAvx512CholeskyKernels;
#if defined(__x86_64__)
    case InstructionSet::kAvx2:
      return __builtin_cpu_supports("fma") ? kAvx2CholeskyKernels : kPortableCholeskyKernels;
#endif
    default:
      return kPortableCholeskyKernels;
  }
}

// Where a block of the matrix goes in the factor.
struct Place {
  size_t offset;
  size_t ld;
  bool transposed;
};

void AddBlock(const Matrix6d& block, const Place& place, double* factor) {
  using Panel = Eigen::Map<Matrix6d, 0, Eigen::OuterStride<>>;
  Panel target(factor + place.offset, Eigen::OuterStride<>(static_cast<Eigen::Index>(place.ld)));
  if (place.transposed) {
    target += block.transpose();
  } else {
    target += block;
  }
}

// Adds the update of a supernode, lower triangle, ld = size, to the panels that it belongs to.
void AddUpdate(const Supernodes& structure,
               const Supernode& source,
               const double* product,
               double* factor) {
  const size_t size = kBlock * source.NumBelow();
  for (const SupernodeUpdate& update : source.updates) {
    const Supernode& target = structure.supernodes[static_cast<size_t>(update.target)];
    const size_t ld = kBlock * target.NumRows();
    for (int32_t c = update.source_begin; c < update.source_end; ++c) {
      const int32_t column = source.rows[source.NumColumns() + static_cast<size_t>(c)];
      double* to = factor + target.panel + kBlock * static_cast<size_t>(column - target.begin) * ld;
      const double* from = product + kBlock * static_cast<size_t>(c) * size;
      for (const RowRun& run : update.runs) {
        const int32_t skipped = std::max(0, c - run.source);
        if (skipped >= run.length) continue;
        const size_t first = kBlock * static_cast<size_t>(run.source + skipped);
        const size_t first_target = kBlock * static_cast<size_t>(run.target + skipped);
        const size_t count = kBlock * static_cast<size_t>(run.length - skipped);
        for (size_t k = 0; k < kBlock; ++k) {
          const double* x = from + k * size + first;
          double* y = to + k * ld + first_target;
          for (size_t i = 0; i < count; ++i) y[i] += x[i];
        }
      }
    }
  }
}

// Six entries of a vector.
template <typename Vector, typename Index>
auto Block(Vector& x, Index i) {
  return x.template segment<6>(static_cast<Eigen::Index>(kBlock) * static_cast<Eigen::Index>(i));
}

// Forwards and backwards through the panels, in the order of elimination.
void SolvePermuted(const Supernodes& structure,
                   const CholeskyKernels& kernels,
                   const double* factor,
                   Eigen::VectorXd* x) {
  const std::vector<Supernode>& supernodes = structure.supernodes;
  Eigen::VectorXd rows(x->size());
  for (const Supernode& supernode : supernodes) {
    for (size_t i = 0; i < supernode.NumRows(); ++i) Block(rows, i) = Block(*x, supernode.rows[i]);
    kernels.solve_forward(factor + supernode.panel, kBlock * supernode.NumRows(),
                          kBlock * supernode.NumColumns(), rows.data());
    for (size_t i = 0; i < supernode.NumRows(); ++i) Block(*x, supernode.rows[i]) = Block(rows, i);
  }
  for (auto supernode = supernodes.rbegin(); supernode != supernodes.rend(); ++supernode) {
    const std::vector<int32_t>& places = supernode->rows;
    for (size_t i = 0; i < places.size(); ++i) Block(rows, i) = Block(*x, places[i]);
    kernels.solve_backward(factor + supernode->panel, kBlock * supernode->NumRows(),
                           kBlock * supernode->NumColumns(), rows.data());
    for (size_t i = 0; i < supernode->NumColumns(); ++i) Block(*x, places[i]) = Block(rows, i);
  }
}

}  // namespace

void SymmetricBlockMatrix::Check() const {
  const auto n = static_cast<int64_t>(diagonal.size());
  if (below.size() != pairs.size()) {
    throw std::invalid_argument("Block matrix: `below` must have one block per pair");
  }
  for (size_t k = 0; k < pairs.size(); ++k) {
    const auto& [column, row] = pairs[k];
    if (column < 0 || column >= row || row >= n || (k > 0 && pairs[k - 1] >= pairs[k])) {
      throw std::invalid_argument("Block matrix: pair " + std::to_string(k) +
                                  " is not below the diagonal, out of range or out of order");
    }
  }
}

struct BlockCholesky::State {
  State(const SymmetricBlockMatrix& matrix, const CholeskyKernels& kernels_of_processor)
      : kernels(kernels_of_processor),
        pairs(matrix.pairs),
        structure(AnalyzeStructure(matrix.diagonal.size(), matrix.pairs)) {
    for (int32_t i = 0; i < static_cast<int32_t>(matrix.diagonal.size()); ++i) {
      diagonal_places.push_back(PlaceOf(i, i));
    }
    for (const auto& [column, row] : pairs) below_places.push_back(PlaceOf(row, column));
    size_t most_rows = 0;
    size_t most_below = 0;
    for (const Supernode& supernode : structure.supernodes) {
      most_rows = std::max(most_rows, supernode.NumRows());
      most_below = std::max(most_below, supernode.NumBelow());
    }
    factor.resize(structure.num_doubles + kCholeskyOverread);
    product.resize(kBlock * kBlock * most_below * most_below + kCholeskyOverread);
    scratch.resize(CholeskyScratchSize(kBlock * most_rows));
  }

  Place PlaceOf(int32_t row, int32_t column) const {
    const int32_t a = structure.position[static_cast<size_t>(row)];
    const int32_t b = structure.position[static_cast<size_t>(column)];
    const auto [first, last] = std::minmax(a, b);
    const Supernode& supernode =
        structure
            .supernodes[static_cast<size_t>(structure.supernode_of[static_cast<size_t>(first)])];
    return {supernode.panel + BlockOffset(supernode, last, first), kBlock * supernode.NumRows(),
            a < b};
  }

  void Load(const SymmetricBlockMatrix& A, const Eigen::VectorXd& diagonal) {
    std::fill(factor.begin(), factor.end(), 0.0);
    for (size_t i = 0; i < A.diagonal.size(); ++i) {
      const Place& place = diagonal_places[i];
      AddBlock(A.diagonal[i], place, factor.data());
      for (size_t k = 0; k < kBlock; ++k) {
        factor[place.offset + k * (place.ld + 1)] +=
            diagonal(static_cast<Eigen::Index>(kBlock * i + k));
      }
    }
    for (size_t k = 0; k < A.below.size(); ++k) {
      AddBlock(A.below[k], below_places[k], factor.data());
    }
  }

  const CholeskyKernels& kernels;
  std::vector<std::pair<int32_t, int32_t>> pairs;
  Supernodes structure;
  std::vector<Place> diagonal_places;
  std::vector<Place> below_places;
  std::vector<double> factor;   // panels
  std::vector<double> product;  // update of one supernode
  std::vector<double> scratch;  // of the kernels
  bool factorized = false;
};

BlockCholesky::BlockCholesky(const SymmetricBlockMatrix& structure,
                             InstructionSet instruction_set) {
  structure.Check();
  state_ = std::make_unique<State>(structure, KernelsFor(instruction_set));
}

BlockCholesky::~BlockCholesky() = default;
BlockCholesky::BlockCholesky(BlockCholesky&&) noexcept = default;
BlockCholesky& BlockCholesky::operator=(BlockCholesky&&) noexcept = default;

bool BlockCholesky::Factorize(const SymmetricBlockMatrix& A, const Eigen::VectorXd& diagonal) {
  State& state = *state_;
  if (A.pairs != state.pairs || A.diagonal.size() != state.diagonal_places.size() ||
      A.below.size() != A.pairs.size() ||
      diagonal.size() != static_cast<Eigen::Index>(kBlock * A.diagonal.size())) {
    throw std::invalid_argument("Cholesky: the matrix has another structure");
  }
  state.factorized = false;
  state.Load(A, diagonal);
  for (const Supernode& supernode : state.structure.supernodes) {
    double* const panel = state.factor.data() + supernode.panel;
    const size_t rows = kBlock * supernode.NumRows();
    const size_t columns = kBlock * supernode.NumColumns();
    if (!state.kernels.factorize(panel, rows, columns, state.scratch.data())) return false;
    if (rows == columns) continue;
    state.kernels.negative_square(panel + columns, rows, rows - columns, columns,
                                  state.product.data(), state.scratch.data());
    AddUpdate(state.structure, supernode, state.product.data(), state.factor.data());
  }
  state.factorized = true;
  return true;
}

Eigen::VectorXd BlockCholesky::Solve(const Eigen::VectorXd& b) const {
  const State& state = *state_;
  if (!state.factorized) throw std::logic_error("Cholesky: no matrix has been factorised");
  if (b.size() != static_cast<Eigen::Index>(kBlock * state.diagonal_places.size())) {
    throw std::invalid_argument("Cholesky: the right-hand side has another size");
  }
  const std::vector<int32_t>& position = state.structure.position;
  Eigen::VectorXd permuted(b.size());
  for (size_t i = 0; i < position.size(); ++i) Block(permuted, position[i]) = Block(b, i);
  SolvePermuted(state.structure, state.kernels, state.factor.data(), &permuted);
  Eigen::VectorXd x(b.size());
  for (size_t i = 0; i < position.size(); ++i) Block(x, i) = Block(permuted, position[i]);
  return x;
}

CholeskyCost BlockCholesky::Cost() const {
  CholeskyCost cost;
  for (const Supernode& supernode : state_->structure.supernodes) {
    const auto p = static_cast<int64_t>(kBlock * supernode.NumColumns());
    const auto m = static_cast<int64_t>(kBlock * supernode.NumRows());
    cost.num_nonzeros += p * (p + 1) / 2 + p * (m - p);
    for (int64_t k = 0; k < p; ++k) cost.num_flops += (m - k) * (m - k);
  }
  cost.num_supernodes = static_cast<int>(state_->structure.supernodes.size());
  return cost;
}

}  // namespace covinz
