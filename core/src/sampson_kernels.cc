// Built with -ffp-contract=off (CMakeLists.txt): one rounding a step makes all versions equal.
#include "sampson_kernels.h"

#include <cstring>

// The compiler splits these eight lanes into whatever registers the instruction set has. Functions
// on them are always inlined: passing such a vector by value depends on the instruction set.
#define COVINZ_INLINE static inline __attribute__((always_inline))

namespace covinz {
namespace {

typedef double Lanes __attribute__((vector_size(kLanes * sizeof(double))));
typedef int64_t Mask __attribute__((vector_size(kLanes * sizeof(int64_t))));

struct Lanes3 {
  Lanes x, y, z;
};

COVINZ_INLINE Lanes Load(const double* p) {
  Lanes lanes;
  std::memcpy(&lanes, p, sizeof(lanes));
  return lanes;
}

COVINZ_INLINE double Sum(const Lanes& v) {
  return ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]));
}

// Zero where the mask is not set, also for NaN.
COVINZ_INLINE Lanes Select(Mask mask, Lanes v) { return (Lanes)((Mask)v & mask); }

COVINZ_INLINE Lanes Dot(const Lanes3& a, const Lanes3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

COVINZ_INLINE Lanes3 Cross(const Lanes3& a, const Lanes3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

COVINZ_INLINE Lanes3 Broadcast(const double* v) {
  const Lanes zero = {};
  return {zero + v[0], zero + v[1], zero + v[2]};
}

// A block under a pose; notation of RigSampson.
struct Block {
  Lanes3 c, r, n;  // n = b x r
  Lanes e, along_query, along_cand;
  Lanes inverse_denominator;
  Lanes error2;
  Mask inlier;
};

COVINZ_INLINE Block Evaluate(const SampsonPose& pose, const double* block) {
  const Lanes3 q = {Load(block), Load(block + kLanes), Load(block + 2 * kLanes)};
  const double* R = pose.R;
  const Lanes3 b = Broadcast(pose.b);
  Block out;
  out.c = {Load(block + 3 * kLanes), Load(block + 4 * kLanes), Load(block + 5 * kLanes)};
  out.r = {R[0] * q.x + R[1] * q.y + R[2] * q.z, R[3] * q.x + R[4] * q.y + R[5] * q.z,
           R[6] * q.x + R[7] * q.y + R[8] * q.z};
  out.n = Cross(b, out.r);
  out.e = Dot(out.c, out.n);
  out.along_query = Dot(b, out.r);
  out.along_cand = Dot(b, out.c);
  const double b2 = pose.b[0] * pose.b[0] + pose.b[1] * pose.b[1] + pose.b[2] * pose.b[2];
  const Lanes e2 = out.e * out.e;
  // |c x b|^2 = |b|^2 - (b.c)^2, |b x r|^2 = |b|^2 - (b.r)^2 for unit c and r.
  const Lanes denominator = pose.query_weight * (b2 - out.along_cand * out.along_cand - e2) +
                            pose.cand_weight * (b2 - out.along_query * out.along_query - e2);
  out.inverse_denominator = 1.0 / denominator;
  out.error2 = e2 * out.inverse_denominator;
  const Lanes cosine = Dot(out.r, out.c);
  const Lanes zero = {};
  const Mask parallel = (1.0 - cosine * cosine) < (zero + pose.max_sine2);
  const Mask in_front =
      (cosine * out.along_cand > out.along_query) & (out.along_cand > cosine * out.along_query);
  const Mask ahead = (parallel & (cosine > zero)) | (~parallel & in_front);
  out.inlier = ahead & (out.error2 <= (zero + pose.max_error2));
  return out;
}

COVINZ_INLINE SampsonSums Score(const SampsonPose& pose,
                                const double* blocks,
                                size_t num_blocks,
                                size_t stride) {
  Lanes gain = {};
  Mask num_inliers = {};
  for (size_t i = 0; i < num_blocks; i += stride) {
    const Block block = Evaluate(pose, blocks + i * kBlockSize);
    gain += Select(block.inlier, pose.max_error2 - block.error2);
    num_inliers -= block.inlier;  // set is -1
  }
  return {Sum(gain), Sum(__builtin_convertvector(num_inliers, Lanes))};
}

COVINZ_INLINE void Mark(const SampsonPose& pose,
                        const double* blocks,
                        size_t num_blocks,
                        int64_t* inliers) {
  for (size_t i = 0; i < num_blocks; ++i) {
    const Mask marks = -Evaluate(pose, blocks + i * kBlockSize).inlier;
    std::memcpy(inliers + i * kLanes, &marks, sizeof(marks));
  }
}

// sqrt(denominator) times the row of J. With k = r x c and m = c x b,
//   de = b'.k + theta.(r x m),   d denominator = 2 b'.g + 2 theta.h - 2 (w_q + w_c) e de,
//   g = w_q (b - (b.c) c) + w_c (b - (b.r) r),   h = w_c (b.r) (b x r),
// and d(e / sqrt(D)) = (de - e dD / (2 D)) / sqrt(D).
COVINZ_INLINE void JacobianRow(const SampsonPose& pose, const Block& block, Lanes J[6]) {
  const Lanes3 b = Broadcast(pose.b);
  const Lanes3 k = Cross(block.r, block.c);
  const Lanes3 rm = Cross(block.r, Cross(block.c, b));
  const double weights = pose.query_weight + pose.cand_weight;
  const Lanes along_e = 1.0 + weights * block.error2;
  const Lanes along_D = block.e * block.inverse_denominator;
  const Lanes wc = pose.query_weight * block.along_cand;
  const Lanes wr = pose.cand_weight * block.along_query;
  J[0] = along_e * rm.x - along_D * (wr * block.n.x);
  J[1] = along_e * rm.y - along_D * (wr * block.n.y);
  J[2] = along_e * rm.z - along_D * (wr * block.n.z);
  J[3] = along_e * k.x - along_D * (weights * b.x - wc * block.c.x - wr * block.r.x);
  J[4] = along_e * k.y - along_D * (weights * b.y - wc * block.c.y - wr * block.r.y);
  J[5] = along_e * k.z - along_D * (weights * b.z - wc * block.c.z - wr * block.r.z);
}

COVINZ_INLINE SampsonNormalSums Linearize(const SampsonPose& pose,
                                          const double* blocks,
                                          size_t num_blocks,
                                          size_t stride) {
  Lanes JtJ[21] = {};
  Lanes Jte[6] = {};
  Lanes cost = {};
  Mask num_inliers = {};
  const double inverse_max_error2 = 1.0 / pose.max_error2;
  for (size_t i = 0; i < num_blocks; i += stride) {
    const Block block = Evaluate(pose, blocks + i * kBlockSize);
    Lanes J[6];
    JacobianRow(pose, block, J);
    const Lanes rest = 1.0 - block.error2 * inverse_max_error2;
    const Lanes rest2 = rest * rest;
    cost += Select(block.inlier, 1.0 - rest2 * rest);
    num_inliers -= block.inlier;
    const Lanes weight = Select(block.inlier, rest2 * block.inverse_denominator);
    const Lanes e = Select(block.inlier, block.e);
    for (Lanes& entry : J) entry = Select(block.inlier, entry);
    for (size_t row = 0, entry = 0; row < 6; ++row) {
      const Lanes weighted = weight * J[row];
      Jte[row] += weighted * e;
      for (size_t col = row; col < 6; ++col, ++entry) JtJ[entry] += weighted * J[col];
    }
  }
  SampsonNormalSums sums;
  for (size_t k = 0; k < 21; ++k) sums.JtJ[k] = Sum(JtJ[k]);
  for (size_t k = 0; k < 6; ++k) sums.Jte[k] = Sum(Jte[k]);
  sums.cost = pose.max_error2 / 3.0 * Sum(cost);
  sums.num_inliers = Sum(__builtin_convertvector(num_inliers, Lanes));
  return sums;
}

}  // namespace

// One function a kernel and instruction set; the inlined code takes on the function's target.
#define COVINZ_VERSIONS(suffix, target)                                                            \
  target static SampsonSums Score##suffix(const SampsonPose& pose, const double* blocks,           \
                                          size_t num_blocks, size_t stride) {                      \
    return Score(pose, blocks, num_blocks, stride);                                                \
  }                                                                                                \
  target static void Mark##suffix(const SampsonPose& pose, const double* blocks,                   \
                                  size_t num_blocks, int64_t* inliers) {                           \
    Mark(pose, blocks, num_blocks, inliers);                                                       \
  }                                                                                                \
  target static SampsonNormalSums Linearize##suffix(const SampsonPose& pose, const double* blocks, \
                                                    size_t num_blocks, size_t stride) {            \
    return Linearize(pose, blocks, num_blocks, stride);                                            \
  }

COVINZ_VERSIONS(Portable, )

#if defined(__x86_64__)
COVINZ_VERSIONS(Avx2, __attribute__((target("avx2"))))
COVINZ_VERSIONS(Avx512, __attribute__((target("avx512f"))))
#define COVINZ_DISPATCH(set, name, ...)                        \
  (set) == InstructionSet::kAvx512 ? name##Avx512(__VA_ARGS__) \
  : (set) == InstructionSet::kAvx2 ? name##Avx2(__VA_ARGS__)   \
                                   : name##Portable(__VA_ARGS__)
#else
#define COVINZ_DISPATCH(set, name, ...) (void)(set), name##Portable(__VA_ARGS__)
#endif

SampsonSums ScoreBlocks(InstructionSet instruction_set,
                        const SampsonPose& pose,
                        const double* blocks,
                        size_t num_blocks,
                        size_t stride) {
  return COVINZ_DISPATCH(instruction_set, Score, pose, blocks, num_blocks, stride);
}

void MarkInliers(InstructionSet instruction_set,
                 const SampsonPose& pose,
                 const double* blocks,
                 size_t num_blocks,
                 int64_t* inliers) {
  COVINZ_DISPATCH(instruction_set, Mark, pose, blocks, num_blocks, inliers);
}

SampsonNormalSums LinearizeBlocks(InstructionSet instruction_set,
                                  const SampsonPose& pose,
                                  const double* blocks,
                                  size_t num_blocks,
                                  size_t stride) {
  return COVINZ_DISPATCH(instruction_set, Linearize, pose, blocks, num_blocks, stride);
}

}  // namespace covinz
