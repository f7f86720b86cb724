// Cholesky kernels in vectors of four with fused multiply-add.
#include "cholesky_kernels.h"

#if defined(__AVX2__) && defined(__FMA__)

#define COVINZ_LANES 4
#define COVINZ_VECTORS 2
#include "cholesky_panel.h"

namespace covinz {
const CholeskyKernels kAvx2CholeskyKernels = kKernels;
}  // namespace covinz

#else

namespace covinz {
const CholeskyKernels kAvx2CholeskyKernels = {};
}  // namespace covinz

#endif
