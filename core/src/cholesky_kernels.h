// The inner loops of BlockCholesky, one version per instruction set.
//
// Each cholesky_kernels_*.cc but the portable one is compiled with flags of its own
// (CMakeLists.txt). So that none of its code is run by mistake on other processors, it defines
// nothing that the linker could share: it includes no library headers with inline functions, nor
// Eigen, and takes plain pointers.
//
// All matrices are column-major. Kernels may read, but never use or write, up to kCholeskyOverread
// doubles beyond the last column.
#pragma once

#include <cstddef>

namespace covinz {

inline constexpr size_t kCholeskyStrip = 6;  // columns are worked on in blocks of a pose
inline constexpr size_t kCholeskyOverread = 24;

// Doubles that a kernel needs to work on a matrix of so many rows.
size_t CholeskyScratchSize(size_t rows);

struct CholeskyKernels {
  // Replaces the first `columns` columns of a symmetric matrix of `rows` rows, its lower triangle
  // given, by those of its Cholesky factor. What is above the diagonal is of no meaning, before
  // and after. False if a pivot is not positive (or not a number).
  bool (*factorize)(double* panel, size_t rows, size_t columns, double* scratch);
  // product = -B B^T, its lower triangle (more is written), ld = size; B is size x depth.
  void (*negative_square)(
      const double* B, size_t ldb, size_t size, size_t depth, double* product, double* scratch);
  // x of `rows` entries: the first `columns` are solved for, the others updated.
  void (*solve_forward)(const double* panel, size_t rows, size_t columns, double* x);
  // The first `columns` entries of x are solved for, given the others.
  void (*solve_backward)(const double* panel, size_t rows, size_t columns, double* x);
};

// Without kernels (null) where the build's processor family has no such instruction set.
extern const CholeskyKernels kPortableCholeskyKernels;
extern const CholeskyKernels kAvx2CholeskyKernels;
extern const CholeskyKernels kAvx512CholeskyKernels;

}  // namespace covinz
