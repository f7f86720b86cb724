// Built with -ffp-contract=off (CMakeLists.txt): one rounding a step makes all versions equal.
#include "sampson_kernels.h"

#include <cstring>

// The compiler splits these sixteen lanes into whatever registers the instruction set has.
// Functions on them are always inlined: passing such a vector by value depends on the instruction
// set.
#define COVINZ_INLINE static inline __attribute__((always_inline))

namespace covinz {
namespace {

typedef float Lanes __attribute__((vector_size(kLanes * sizeof(float))));
typedef int32_t Mask __attribute__((vector_size(kLanes * sizeof(int32_t))));

struct Lanes3 {
  Lanes x, y, z;
};

COVINZ_INLINE Lanes Load(const float* p) {
  Lanes lanes;
  std::memcpy(&lanes, p, sizeof(lanes));
  return lanes;
}

typedef float Lanes8 __attribute__((vector_size(8 * sizeof(float))));
typedef float Lanes4 __attribute__((vector_size(4 * sizeof(float))));

// In one order on every instruction set.
COVINZ_INLINE double Sum(const Lanes& v) {
  Lanes8 eights[2];
  std::memcpy(eights, &v, sizeof(eights));
  const Lanes8 eight = eights[0] + eights[1];
  Lanes4 fours[2];
  std::memcpy(fours, &eight, sizeof(fours));
  const Lanes4 four = fours[0] + fours[1];
  return static_cast<double>((four[0] + four[2]) + (four[1] + four[3]));
}

// Set where a < b, by the sign of the difference: compilers make scalar code of comparisons of
// vectors that AVX-512 has in other registers.
COVINZ_INLINE Mask IsLess(const Lanes& a, const Lanes& b) { return (Mask)(a - b) >> 31; }

// Zero where the mask is not set, also for NaN.
COVINZ_INLINE Lanes Select(Mask mask, Lanes v) { return (Lanes)((Mask)v & mask); }

COVINZ_INLINE Lanes Dot(const Lanes3& a, const Lanes3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

COVINZ_INLINE Lanes3 Cross(const Lanes3& a, const Lanes3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

COVINZ_INLINE Lanes3 Broadcast(const float* v) {
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

COVINZ_INLINE Block Evaluate(const SampsonTask& pose, const float* block) {
  const Lanes3 q = {Load(block), Load(block + kLanes), Load(block + 2 * kLanes)};
  const float* R = pose.R;
  const Lanes3 b = Broadcast(pose.b);
  Block out;
  out.c = {Load(block + 3 * kLanes), Load(block + 4 * kLanes), Load(block + 5 * kLanes)};
  out.r = {R[0] * q.x + R[1] * q.y + R[2] * q.z, R[3] * q.x + R[4] * q.y + R[5] * q.z,
           R[6] * q.x + R[7] * q.y + R[8] * q.z};
  out.n = Cross(b, out.r);
  out.e = Dot(out.c, out.n);
  out.along_query = Dot(b, out.r);
  out.along_cand = Dot(b, out.c);
  const float b2 = pose.b[0] * pose.b[0] + pose.b[1] * pose.b[1] + pose.b[2] * pose.b[2];
  const Lanes e2 = out.e * out.e;
  // |c x b|^2 = |b|^2 - (b.c)^2, |b x r|^2 = |b|^2 - (b.r)^2 for unit c and r.
  const Lanes denominator = pose.query_weight * (b2 - out.along_cand * out.along_cand - e2) +
                            pose.cand_weight * (b2 - out.along_query * out.along_query - e2);
  out.inverse_denominator = 1.0f / denominator;
  out.error2 = e2 * out.inverse_denominator;
  const Lanes cosine = Dot(out.r, out.c);
  const Lanes zero = {};
  const Mask parallel = IsLess(1.0f - cosine * cosine, zero + pose.max_sine2);
  const Mask in_front = IsLess(out.along_query, cosine * out.along_cand) &
                        IsLess(cosine * out.along_query, out.along_cand);
  const Mask ahead = (parallel & IsLess(zero, cosine)) | (~parallel & in_front);
  // False for a denominator of zero.
  out.inlier = ahead & IsLess(e2, pose.max_error2 * denominator);
  return out;
}

COVINZ_INLINE SampsonSums Score(const SampsonTask* tasks, size_t num_tasks, size_t stride) {
  Lanes gain = {};
  Mask num_inliers = {};
  for (const SampsonTask* task = tasks; task != tasks + num_tasks; ++task) {
    for (size_t i = 0; i < task->num_blocks; i += stride) {
      const Block block = Evaluate(*task, task->blocks + i * kBlockSize);
      gain += Select(block.inlier, task->max_error2 - block.error2);
      num_inliers -= block.inlier;  // set is -1
    }
  }
  return {Sum(gain), Sum(__builtin_convertvector(num_inliers, Lanes))};
}

COVINZ_INLINE void Mark(const SampsonTask& task, int32_t* inliers) {
  for (size_t i = 0; i < task.num_blocks; ++i) {
    const Mask marks = -Evaluate(task, task.blocks + i * kBlockSize).inlier;
    std::memcpy(inliers + i * kLanes, &marks, sizeof(marks));
  }
}

// sqrt(denominator) times the row of J. With k = r x c and m = c x b,
//   de = b'.k + theta.(r x m),   d denominator = 2 b'.g + 2 theta.h - 2 (w_q + w_c) e de,
//   g = w_q (b - (b.c) c) + w_c (b - (b.r) r),   h = w_c (b.r) (b x r),
// and d(e / sqrt(D)) = (de - e dD / (2 D)) / sqrt(D). A motion (theta, rho) of the pose moves b by
// b' = theta x R p_q + rho.
COVINZ_INLINE void JacobianRow(const SampsonTask& pose, const Block& block, Lanes J[6]) {
  const Lanes3 b = Broadcast(pose.b);
  const Lanes3 k = Cross(block.r, block.c);
  const Lanes3 rm = Cross(block.r, Cross(block.c, b));
  const float weights = pose.query_weight + pose.cand_weight;
  const Lanes along_e = 1.0f + weights * block.error2;
  const Lanes along_D = block.e * block.inverse_denominator;
  const Lanes wc = pose.query_weight * block.along_cand;
  const Lanes wr = pose.cand_weight * block.along_query;
  const Lanes3 along_b = {
      along_e * k.x - along_D * (weights * b.x - wc * block.c.x - wr * block.r.x),
      along_e * k.y - along_D * (weights * b.y - wc * block.c.y - wr * block.r.y),
      along_e * k.z - along_D * (weights * b.z - wc * block.c.z - wr * block.r.z)};
  const Lanes3 turn = Cross(Broadcast(pose.lever), along_b);
  J[0] = along_e * rm.x - along_D * (wr * block.n.x) + turn.x;
  J[1] = along_e * rm.y - along_D * (wr * block.n.y) + turn.y;
  J[2] = along_e * rm.z - along_D * (wr * block.n.z) + turn.z;
  J[3] = along_b.x;
  J[4] = along_b.y;
  J[5] = along_b.z;
}

COVINZ_INLINE SampsonNormalSums Linearize(const SampsonTask* tasks,
                                          size_t num_tasks,
                                          size_t stride) {
  Lanes JtJ[21] = {};
  Lanes Jte[6] = {};
  Lanes cost = {};
  Mask num_inliers = {};
  const float inverse_max_error2 = 1.0f / tasks->max_error2;
  for (const SampsonTask* task = tasks; task != tasks + num_tasks; ++task) {
    for (size_t i = 0; i < task->num_blocks; i += stride) {
      const Block block = Evaluate(*task, task->blocks + i * kBlockSize);
      Lanes J[6];
      JacobianRow(*task, block, J);
      const Lanes rest = 1.0f - block.error2 * inverse_max_error2;
      const Lanes rest2 = rest * rest;
      cost += Select(block.inlier, 1.0f - rest2 * rest);
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
  }
  SampsonNormalSums sums;
  for (size_t k = 0; k < 21; ++k) sums.JtJ[k] = Sum(JtJ[k]);
  for (size_t k = 0; k < 6; ++k) sums.Jte[k] = Sum(Jte[k]);
  sums.cost = static_cast<double>(tasks->max_error2) / 3.0 * Sum(cost);
  sums.num_inliers = Sum(__builtin_convertvector(num_inliers, Lanes));
  return sums;
}

}  // namespace

// One function a kernel and instruction set; the inlined code takes on the function's target.
#define COVINZ_VERSIONS(suffix, target)                                                         \
  target static SampsonSums Score##suffix(const SampsonTask* tasks, size_t num_tasks,           \
                                          size_t stride) {                                      \
    return Score(tasks, num_tasks, stride);                                                     \
  }                                                                                             \
  target static void Mark##suffix(const SampsonTask& task, int32_t* inliers) {                  \
    Mark(task, inliers);                                                                        \
  }                                                                                             \
  target static SampsonNormalSums Linearize##suffix(const SampsonTask* tasks, size_t num_tasks, \
                                                    size_t stride) {                            \
    return Linearize(tasks, num_tasks, stride);                                                 \
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
                        const SampsonTask* tasks,
                        size_t num_tasks,
                        size_t stride) {
  return COVINZ_DISPATCH(instruction_set, Score, tasks, num_tasks, stride);
}

void MarkInliers(InstructionSet instruction_set, const SampsonTask& task, int32_t* inliers) {
  COVINZ_DISPATCH(instruction_set, Mark, task, inliers);
}

SampsonNormalSums LinearizeBlocks(InstructionSet instruction_set,
                                  const SampsonTask* tasks,
                                  size_t num_tasks,
                                  size_t stride) {
  return COVINZ_DISPATCH(instruction_set, Linearize, tasks, num_tasks, stride);
}

}  // namespace covinz
