// Dense Cholesky factorisation of a panel, in vectors of COVINZ_LANES doubles; included by
// cholesky_kernels_*.cc alone.
//
// A tile of COVINZ_VECTORS vectors by six columns stays in registers while it sums over the depth.
// Within a block of kBlock columns every strip of six is updated, factorised and solved against in
// one go; then the block is subtracted from what is to its right. Large matrices are first packed,
// so that a tile reads its operands in order.
//
// Source: Goto and van de Geijn, "Anatomy of high-performance matrix multiplication", 2008.
#include "cholesky_kernels.h"

#define COVINZ_INLINE inline __attribute__((always_inline))

namespace covinz {
namespace {

constexpr size_t kLanes = COVINZ_LANES;
constexpr size_t kVectors = COVINZ_VECTORS;
constexpr size_t kTileRows = kLanes * kVectors;
constexpr size_t kStrip = kCholeskyStrip;
// Columns of a block: a packed tile of rows (24 x 96 doubles) stays in the first-level cache.
constexpr size_t kBlock = 96;
// From so many rows on, packing costs less than it saves.
constexpr size_t kPackedRows = 96;
static_assert(kTileRows <= kCholeskyOverread && kBlock % kStrip == 0, "");

typedef double Lanes __attribute__((vector_size(COVINZ_LANES * 8)));
typedef double UnalignedLanes __attribute__((vector_size(COVINZ_LANES * 8), aligned(8), may_alias));

COVINZ_INLINE Lanes Load(const double* x) { return *reinterpret_cast<const UnalignedLanes*>(x); }
COVINZ_INLINE void Store(double* x, Lanes lanes) { *reinterpret_cast<UnalignedLanes*>(x) = lanes; }

// A matrix or its packed copy: row i at depth k is data[i + k * stride].
struct Operand {
  const double* data;
  size_t stride;
};

template <size_t kHeight>
struct Tile {
  Lanes column[kStrip][kHeight];

  COVINZ_INLINE void SetZero() {
    for (size_t c = 0; c < kStrip; ++c) {
      for (size_t v = 0; v < kHeight; ++v) column[c][v] = Lanes{};
    }
  }

  COVINZ_INLINE void Read(const double* matrix, size_t ld) {
    for (size_t c = 0; c < kStrip; ++c) {
      for (size_t v = 0; v < kHeight; ++v) column[c][v] = Load(matrix + c * ld + v * kLanes);
    }
  }

  // Its first `rows` rows; the others belong to the next column.
  COVINZ_INLINE void Write(size_t rows, double* matrix, size_t ld) const {
    if (rows == kHeight * kLanes) {
      for (size_t c = 0; c < kStrip; ++c) {
        for (size_t v = 0; v < kHeight; ++v) Store(matrix + c * ld + v * kLanes, column[c][v]);
      }
      return;
    }
    for (size_t c = 0; c < kStrip; ++c) {
      double buffer[kHeight * kLanes];
      for (size_t v = 0; v < kHeight; ++v) Store(buffer + v * kLanes, column[c][v]);
      for (size_t r = 0; r < rows; ++r) matrix[c * ld + r] = buffer[r];
    }
  }

  // Subtracts A B^T.
  COVINZ_INLINE void Subtract(Operand A, Operand B, size_t depth) {
    for (size_t k = 0; k < depth; ++k) {
      Lanes a[kHeight];
      for (size_t v = 0; v < kHeight; ++v) a[v] = Load(A.data + v * kLanes);
      for (size_t c = 0; c < kStrip; ++c) {
        const Lanes b = B.data[c] - Lanes{};
        for (size_t v = 0; v < kHeight; ++v) column[c][v] -= a[v] * b;
      }
      A.data += A.stride;
      B.data += B.stride;
    }
  }

  // X of X L^T = this, L by columns, its diagonal inverted.
  COVINZ_INLINE void SolveAgainst(const double (&L)[kStrip][kStrip]) {
    for (size_t c = 0; c < kStrip; ++c) {
      for (size_t v = 0; v < kHeight; ++v) column[c][v] *= L[c][c];
      for (size_t d = c + 1; d < kStrip; ++d) {
        for (size_t v = 0; v < kHeight; ++v) column[d][v] -= column[c][v] * L[c][d];
      }
    }
  }
};

// Runs `work` with the height of a tile that covers `rows`, at most kTileRows, as its type.
template <typename Work>
COVINZ_INLINE void WithTile(size_t rows, const Work& work) {
  if (rows > 2 * kLanes) {
    work(Tile<kVectors>());
  } else if (rows > kLanes) {
    work(Tile<2>());
  } else {
    work(Tile<1>());
  }
}

COVINZ_INLINE size_t Least(size_t a, size_t b) { return a < b ? a : b; }

// The Cholesky factor of a strip's own six rows, in place; by columns with the diagonal inverted
// in L too. False if a pivot is not positive.
bool FactorizeStrip(double* strip, size_t ld, double (&L)[kStrip][kStrip]) {
  for (size_t c = 0; c < kStrip; ++c) {
    double pivot = strip[c * ld + c];
    for (size_t k = 0; k < c; ++k) pivot -= L[k][c] * L[k][c];
    if (!(pivot > 0.0 && pivot <= __DBL_MAX__)) return false;
    const double root = __builtin_sqrt(pivot);
    strip[c * ld + c] = root;
    L[c][c] = 1.0 / root;
    for (size_t r = c + 1; r < kStrip; ++r) {
      double sum = strip[c * ld + r];
      for (size_t k = 0; k < c; ++k) sum -= L[k][c] * L[k][r];
      strip[c * ld + r] = L[c][r] = sum * L[c][c];
    }
  }
  return true;
}

// Factorises `columns` columns, at most kBlock.
bool FactorizeBlock(double* panel, size_t ld, size_t rows, size_t columns) {
  for (size_t j = 0; j < columns; j += kStrip) {
    const Operand B = {panel + j, ld};
    double* const strip = panel + j * ld;
    for (size_t i = j; i < j + kStrip; i += kTileRows) {
      const size_t height = Least(j + kStrip - i, kTileRows);
      WithTile(height, [&](auto tile) {
        tile.Read(strip + i, ld);
        tile.Subtract({panel + i, ld}, B, j);
        tile.Write(height, strip + i, ld);
      });
    }
    double L[kStrip][kStrip];
    if (!FactorizeStrip(strip + j, ld, L)) return false;
    for (size_t i = j + kStrip; i < rows; i += kTileRows) {
      const size_t height = Least(rows - i, kTileRows);
      WithTile(height, [&](auto tile) {
        tile.Read(strip + i, ld);
        tile.Subtract({panel + i, ld}, B, j);
        tile.SolveAgainst(L);
        tile.Write(height, strip + i, ld);
      });
    }
  }
  return true;
}

// `rows` rows of a matrix, one after the other at each depth.
void Pack(Operand matrix, size_t rows, size_t depth, double* packed) {
  for (size_t k = 0; k < depth; ++k) {
    for (size_t r = 0; r < rows; ++r) packed[r] = matrix.data[k * matrix.stride + r];
    packed += rows;
  }
}

// C -= B B^T (or C = -B B^T), the part on and below the diagonal of its first `columns` columns.
// The depth is at most kBlock.
void SubtractSquare(Operand B,
                    size_t rows,
                    size_t columns,
                    size_t depth,
                    bool assign,
                    double* C,
                    size_t ldc,
                    double* scratch) {
  const bool packed = rows >= kPackedRows;
  double* const packed_tile = scratch;
  double* const packed_strips = scratch + kTileRows * kBlock;
  if (packed) {
    for (size_t j = 0; j < columns; j += kStrip) {
      Pack({B.data + j, B.stride}, kStrip, depth, packed_strips + j * depth);
    }
  }
  for (size_t i = 0; i < rows; i += kTileRows) {
    const size_t height = Least(rows - i, kTileRows);
    Operand A = {B.data + i, B.stride};
    if (packed && height == kTileRows) {
      Pack(A, kTileRows, depth, packed_tile);
      A = {packed_tile, kTileRows};
    }
    for (size_t j = 0; j < Least(i + height, columns); j += kStrip) {
      const Operand strip =
          packed ? Operand{packed_strips + j * depth, kStrip} : Operand{B.data + j, B.stride};
      WithTile(height, [&](auto tile) {
        if (assign) {
          tile.SetZero();
        } else {
          tile.Read(C + j * ldc + i, ldc);
        }
        tile.Subtract(A, strip, depth);
        tile.Write(height, C + j * ldc + i, ldc);
      });
    }
  }
}

bool Factorize(double* panel, size_t rows, size_t columns, double* scratch) {
  for (size_t j = 0; j < columns; j += kBlock) {
    const size_t width = Least(columns - j, kBlock);
    double* const block = panel + j * rows + j;
    if (!FactorizeBlock(block, rows, rows - j, width)) return false;
    if (j + width == columns) break;
    SubtractSquare({block + width, rows}, rows - j - width, columns - j - width, width, false,
                   block + width * rows + width, rows, scratch);
  }
  return true;
}

void NegativeSquare(
    const double* B, size_t ldb, size_t size, size_t depth, double* product, double* scratch) {
  for (size_t k = 0; k < depth; k += kBlock) {
    SubtractSquare({B + k * ldb, ldb}, size, size, Least(depth - k, kBlock), k == 0, product, size,
                   scratch);
  }
}

void SolveForward(const double* panel, size_t rows, size_t columns, double* x) {
  for (size_t c = 0; c < columns; ++c) {
    const double* column = panel + c * rows;
    const double solved = x[c] /= column[c];
    for (size_t r = c + 1; r < rows; ++r) x[r] -= solved * column[r];
  }
}

void SolveBackward(const double* panel, size_t rows, size_t columns, double* x) {
  for (size_t c = columns; c-- > 0;) {
    const double* column = panel + c * rows;
    Lanes sums = {};
    size_t r = c + 1;
    for (; r + kLanes <= rows; r += kLanes) sums += Load(column + r) * Load(x + r);
    double sum = 0.0;
    for (size_t lane = 0; lane < kLanes; ++lane) sum += sums[lane];
    for (; r < rows; ++r) sum += column[r] * x[r];
    x[c] = (x[c] - sum) / column[c];
  }
}

constexpr CholeskyKernels kKernels = {Factorize, NegativeSquare, SolveForward, SolveBackward};

}  // namespace
}  // namespace covinz
