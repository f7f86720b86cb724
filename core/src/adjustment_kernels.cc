// Built with -ffp-contract=off (CMakeLists.txt): one rounding a step makes all versions equal.
#include "adjustment_kernels.h"

#include <cmath>
#include <cstdint>
#include <cstring>

// The compiler splits these eight lanes into whatever registers the instruction set has. Functions
// on them are always inlined: passing such a vector by value depends on the instruction set.
#define COVINZ_INLINE static inline __attribute__((always_inline))

namespace covinz {
namespace {

typedef double Lanes __attribute__((vector_size(kTrackLanes * sizeof(double))));
typedef uint64_t Bits __attribute__((vector_size(kTrackLanes * sizeof(uint64_t))));

struct Lanes3 {
  Lanes x, y, z;
};

COVINZ_INLINE Lanes Load(const double* p) {
  Lanes lanes;
  std::memcpy(&lanes, p, sizeof(lanes));
  return lanes;
}
COVINZ_INLINE Lanes3 Load3(const double* p) {
  return {Load(p), Load(p + kTrackLanes), Load(p + 2 * kTrackLanes)};
}
COVINZ_INLINE void Store(const Lanes& lanes, double* p) { std::memcpy(p, &lanes, sizeof(lanes)); }
COVINZ_INLINE void Add(const Lanes& lanes, double* p) { Store(Load(p) + lanes, p); }
COVINZ_INLINE void Subtract(const Lanes& lanes, double* p) { Store(Load(p) - lanes, p); }

COVINZ_INLINE Lanes Dot(const Lanes3& a, const Lanes3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
COVINZ_INLINE Lanes Dot(const Lanes3& a, const double* b) {
  return a.x * b[0] + a.y * b[1] + a.z * b[2];
}
COVINZ_INLINE Lanes3 Cross(const Lanes3& a, const Lanes3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
COVINZ_INLINE Lanes3 Scale(const Lanes& s, const Lanes3& v) { return {s * v.x, s * v.y, s * v.z}; }
COVINZ_INLINE Lanes3 Minus(const Lanes3& a, const Lanes3& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}

COVINZ_INLINE Lanes InverseRoot(const Lanes& v) {
  double roots[kTrackLanes];
  Store(v, roots);
  for (double& root : roots) root = std::sqrt(root);
  return 1.0 / Load(roots);
}

// All bits of the lanes whose sign is set.
COVINZ_INLINE Bits IsNegative(const Lanes& v) { return Bits{} - ((Bits)v >> 63); }
COVINZ_INLINE Lanes Select(const Bits& mask, const Lanes& yes, const Lanes& no) {
  return (Lanes)(((Bits)yes & mask) | ((Bits)no & ~mask));
}

// In one order on every instruction set.
COVINZ_INLINE double Sum(const Lanes& v) {
  return ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]));
}

// TangentBasis of bearing_residual.h.
COVINZ_INLINE void TangentRows(const Lanes3& v, Lanes3 rows[2]) {
  const Lanes one = Lanes{} + 1.0;
  const Lanes sign = Select(IsNegative(v.z), -one, one);
  const Lanes a = -1.0 / (sign + v.z);
  const Lanes b = v.x * v.y * a;
  rows[0] = {1.0 + sign * v.x * v.x * a, sign * b, -sign * v.x};
  rows[1] = {b, sign + v.y * v.y * a, -v.y};
}

// A product of many factors, kept in range.
struct Product {
  Lanes mantissa;
  Bits exponent;

  __attribute__((always_inline)) void Times(const Lanes& factor) {
    const Bits bits = (Bits)(mantissa * factor);
    exponent += (bits >> 52) - 1023;
    mantissa = (Lanes)((bits & 0xfffffffffffffULL) | 0x3ff0000000000000ULL);
  }

  // Sum over the lanes of the logarithms.
  __attribute__((always_inline)) double Log() const {
    double sum = 0.0;
    for (size_t lane = 0; lane < kTrackLanes; ++lane) {
      sum += std::log(mantissa[lane]) +
             0.69314718055994530942 * static_cast<double>(static_cast<int64_t>(exponent[lane]));
    }
    return sum;
  }
};

// The point of each lane with its equations so far.
struct Point {
  Lanes3 direction;
  Lanes inverse_distance;
  Lanes3 basis[2];
  Lanes V[6];  // xx, xy, xz, yy, yz, zz
  Lanes3 g;
};

// EvaluateBearing of bearing_residual.h with the weight of the loss.
struct Residual {
  Lanes e[2];
  Lanes J_cam[2][6];
  Lanes3 J_point[2];
  Lanes weight;
  Lanes cost_factor;  // the loss is keypoint_loss2 times its logarithm
};

COVINZ_INLINE void Evaluate(const AdjustmentPose& pose,
                            const AdjustmentView& view,
                            const Point& point,
                            double loss2,
                            Residual& out) {
  const double* R = pose.R;
  const double* t = pose.t;
  const Lanes w = point.inverse_distance;
  const Lanes3 u = {point.direction.x - w * t[0], point.direction.y - w * t[1],
                    point.direction.z - w * t[2]};
  const Lanes3 ray = {u.x * R[0] + u.y * R[3] + u.z * R[6], u.x * R[1] + u.y * R[4] + u.z * R[7],
                      u.x * R[2] + u.y * R[5] + u.z * R[8]};
  const Lanes inverse_length = InverseRoot(Dot(ray, ray));
  const Lanes3 unit = Scale(inverse_length, ray);
  const Lanes3 basis[2] = {Load3(view.whitened_basis),
                           Load3(view.whitened_basis + 3 * kTrackLanes)};
  for (int r = 0; r < 2; ++r) {
    out.e[r] = Dot(basis[r], unit);
    const Lanes3 J_ray = Scale(inverse_length, Minus(basis[r], Scale(out.e[r], unit)));
    const Lanes3 turn = Cross(J_ray, ray);
    out.J_cam[r][0] = turn.x;
    out.J_cam[r][1] = turn.y;
    out.J_cam[r][2] = turn.z;
    out.J_cam[r][3] = -w * J_ray.x;
    out.J_cam[r][4] = -w * J_ray.y;
    out.J_cam[r][5] = -w * J_ray.z;
    const Lanes3 J_world = {Dot(J_ray, R), Dot(J_ray, R + 3), Dot(J_ray, R + 6)};
    out.J_point[r] = {Dot(J_world, point.basis[0]), Dot(J_world, point.basis[1]), -Dot(J_world, t)};
  }
  const Lanes error2 = out.e[0] * out.e[0] + out.e[1] * out.e[1];
  const Bits in_front = IsNegative(-Dot(Load3(view.bearing), unit));
  out.weight = Select(in_front, loss2 / (loss2 + error2), Lanes{});
  out.cost_factor = 1.0 + Select(in_front, error2, Dot(basis[0], basis[0])) / loss2;
}

COVINZ_INLINE void AddToPoint(const Residual& residual, Point& point) {
  for (int r = 0; r < 2; ++r) {
    const Lanes3& J = residual.J_point[r];
    const Lanes3 weighted = Scale(residual.weight, J);
    point.V[0] += weighted.x * J.x;
    point.V[1] += weighted.x * J.y;
    point.V[2] += weighted.x * J.z;
    point.V[3] += weighted.y * J.y;
    point.V[4] += weighted.y * J.z;
    point.V[5] += weighted.z * J.z;
    point.g.x += weighted.x * residual.e[r];
    point.g.y += weighted.y * residual.e[r];
    point.g.z += weighted.z * residual.e[r];
  }
}

COVINZ_INLINE void AddToCamera(
    const Residual& residual, double damping, double* hessian, double* gradient, double* W) {
  for (size_t i = 0; i < 6; ++i) {
    const Lanes first = residual.weight * residual.J_cam[0][i];
    const Lanes second = residual.weight * residual.J_cam[1][i];
    for (size_t j = 0; j < i; ++j) {
      Add(first * residual.J_cam[0][j] + second * residual.J_cam[1][j],
          hessian + (6 * i + j) * kTrackLanes);
    }
    Add((1.0 + damping) * (first * residual.J_cam[0][i] + second * residual.J_cam[1][i]),
        hessian + 7 * i * kTrackLanes);
    Add(first * residual.e[0] + second * residual.e[1], gradient + i * kTrackLanes);
    const Lanes3* J = residual.J_point;
    Store(first * J[0].x + second * J[1].x, W + (3 * i) * kTrackLanes);
    Store(first * J[0].y + second * J[1].y, W + (3 * i + 1) * kTrackLanes);
    Store(first * J[0].z + second * J[1].z, W + (3 * i + 2) * kTrackLanes);
  }
}

// Upper triangle of the inverse of a symmetric matrix of three rows.
COVINZ_INLINE void Invert(const Lanes V[6], Lanes inverse[6]) {
  const Lanes xx = V[3] * V[5] - V[4] * V[4];
  const Lanes xy = V[2] * V[4] - V[1] * V[5];
  const Lanes xz = V[1] * V[4] - V[2] * V[3];
  const Lanes scale = 1.0 / (V[0] * xx + V[1] * xy + V[2] * xz);
  inverse[0] = scale * xx;
  inverse[1] = scale * xy;
  inverse[2] = scale * xz;
  inverse[3] = scale * (V[0] * V[5] - V[2] * V[2]);
  inverse[4] = scale * (V[1] * V[2] - V[0] * V[4]);
  inverse[5] = scale * (V[0] * V[3] - V[1] * V[1]);
}

COVINZ_INLINE size_t PairAt(size_t a, size_t b) { return (a - 1) * a / 2 + b - 1; }

// H_ab -= W_a V^-1 W_b^T and g_a -= W_a V^-1 g for the views [view, end) of a block.
COVINZ_INLINE void Eliminate(const AdjustmentTask& task,
                             size_t begin,
                             size_t end,
                             const Lanes inverse[6],
                             const Lanes3& g,
                             const CouplingEquations* couplings,
                             double* hessian,
                             double* gradient) {
  for (size_t v = begin; v < end; ++v) {
    const size_t a = static_cast<size_t>(task.views[v].camera);
    if (a == 0) continue;
    Lanes3 scaled[6];
    for (size_t i = 0; i < 6; ++i) {
      const Lanes3 row = Load3(couplings[v].W + 3 * i * kTrackLanes);
      scaled[i] = {row.x * inverse[0] + row.y * inverse[1] + row.z * inverse[2],
                   row.x * inverse[1] + row.y * inverse[3] + row.z * inverse[4],
                   row.x * inverse[2] + row.y * inverse[4] + row.z * inverse[5]};
      Subtract(Dot(scaled[i], g), gradient + (6 * (a - 1) + i) * kTrackLanes);
    }
    for (size_t u = begin; u <= v; ++u) {
      const size_t b = static_cast<size_t>(task.views[u].camera);
      if (b == 0) continue;
      double* block = hessian + 36 * PairAt(a, b) * kTrackLanes;
      for (size_t j = 0; j < 6; ++j) {
        const Lanes3 other = Load3(couplings[u].W + 3 * j * kTrackLanes);
        for (size_t i = u == v ? j : 0; i < 6; ++i) {
          Subtract(Dot(scaled[i], other), block + (6 * i + j) * kTrackLanes);
        }
      }
    }
  }
}

COVINZ_INLINE double Linearize(const AdjustmentTask& task, const TrackEquations& equations) {
  Product product = {Lanes{} + 1.0, Bits{}};
  Lanes prior_cost = {};
  for (size_t block = 0; block < task.num_blocks; ++block) {
    const double* lanes = task.points + 4 * kTrackLanes * block;
    Point point = {};
    point.direction = Load3(lanes);
    point.inverse_distance = Load(lanes + 3 * kTrackLanes);
    TangentRows(point.direction, point.basis);
    point.V[0] = point.V[3] = Lanes{} + task.direction_information;
    point.V[5] = Lanes{} + task.inverse_distance_information;
    point.g.z = task.inverse_distance_information * point.inverse_distance;
    prior_cost += point.g.z * point.inverse_distance;
    for (size_t v = task.begins[block]; v < task.begins[block + 1]; ++v) {
      const AdjustmentView& view = task.views[v];
      const size_t camera = static_cast<size_t>(view.camera);
      Residual residual;
      Evaluate(task.poses[camera], view, point, task.keypoint_loss2, residual);
      product.Times(residual.cost_factor);
      AddToPoint(residual, point);
      if (camera == 0) continue;
      AddToCamera(residual, task.damping,
                  equations.hessian + 36 * PairAt(camera, camera) * kTrackLanes,
                  equations.gradient + 6 * (camera - 1) * kTrackLanes, equations.couplings[v].W);
    }
    point.V[0] *= 1.0 + task.damping;
    point.V[3] *= 1.0 + task.damping;
    point.V[5] *= 1.0 + task.damping;
    Lanes inverse[6];
    Invert(point.V, inverse);
    PointEquations& of_point = equations.points[block];
    for (size_t k = 0; k < 6; ++k) Store(inverse[k], of_point.inverse_V + k * kTrackLanes);
    Store(point.g.x, of_point.g);
    Store(point.g.y, of_point.g + kTrackLanes);
    Store(point.g.z, of_point.g + 2 * kTrackLanes);
    Eliminate(task, task.begins[block], task.begins[block + 1], inverse, point.g,
              equations.couplings, equations.hessian, equations.gradient);
  }
  return task.keypoint_loss2 * product.Log() + Sum(prior_cost);
}

}  // namespace

// One function an instruction set; the inlined code takes on the function's target.
#define COVINZ_VERSION(suffix, target)                                                            \
  target static double Linearize##suffix(const AdjustmentTask& task, const TrackEquations& out) { \
    return Linearize(task, out);                                                                  \
  }

COVINZ_VERSION(Portable, )
#if defined(__x86_64__)
COVINZ_VERSION(Avx2, __attribute__((target("avx2"))))
COVINZ_VERSION(Avx512, __attribute__((target("avx512f"))))
#endif

double SumLanes(const double* lanes) { return Sum(Load(lanes)); }

double LinearizeTracks(InstructionSet instruction_set,
                       const AdjustmentTask& task,
                       const TrackEquations& equations) {
#if defined(__x86_64__)
  if (instruction_set == InstructionSet::kAvx512) return LinearizeAvx512(task, equations);
  if (instruction_set == InstructionSet::kAvx2) return LinearizeAvx2(task, equations);
#endif
  (void)instruction_set;
  return LinearizePortable(task, equations);
}

}  // namespace covinz
