// Cholesky kernels in vectors of eight with fused multiply-add.
#include "cholesky_kernels.h"

#if defined(__AVX512F__)

#define COVINZ_LANES 8
#define COVINZ_VECTORS 3
#include "cholesky_panel.h"

namespace covinz {
const CholeskyKernels kAvx512CholeskyKernels = kKernels;
}  // namespace covinz

#else

namespace covinz {
const CholeskyKernels kAvx512CholeskyKernels = {};
}  // namespace covinz

#endif
