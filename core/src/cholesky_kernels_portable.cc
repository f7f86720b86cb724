// Cholesky kernels for any processor, in the compiler's vectors of two (SSE2, NEON).
#define COVINZ_LANES 2
#define COVINZ_VECTORS 2
#include "cholesky_panel.h"

namespace covinz {

const CholeskyKernels kPortableCholeskyKernels = kKernels;

size_t CholeskyScratchSize(size_t rows) {
  return (rows + kCholeskyOverread) * kBlock + kCholeskyOverread * kBlock;
}

}  // namespace covinz
