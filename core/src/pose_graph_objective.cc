// Residuals, their normal equations and the Cauchy loss of pose graphs.
#include "pose_graph_objective.h"

#include <algorithm>
#include <cmath>

namespace covinz {
namespace {

using Eigen::Matrix3d;

Pose ToPose(const Eigen::Isometry3d& T) {
  return {Eigen::Quaterniond(Eigen::Matrix3d(T.linear())).normalized(), T.translation()};
}

template <typename A, typename B>
Matrix3d Product(const A& a, const B& b) {
  Matrix3d product;
  product.noalias() = a * b;
  return product;
}

// Hat(a) * M.
Matrix3d CrossColumns(const Eigen::Vector3d& a, const Matrix3d& M) {
  Matrix3d product;
  for (int c = 0; c < 3; ++c) product.col(c) = a.cross(M.col(c));
  return product;
}

// w and k of ModelOfEdge.
struct LossWeights {
  double w = 1.0;
  double k = 0.0;
};

// rho'(s) = 1 / (1 + s / a^2), rho''(s) = -rho'^2 / a^2. The curvature along the error,
// rho' + 2 s rho'', is negative from s = a^2 on: there it is taken as zero.
LossWeights CauchyWeights(double chi2, double scale, Curvature curvature) {
  const double a2 = scale * scale;
  LossWeights weights;
  weights.w = 1.0 / (1.0 + chi2 / a2);
  if (curvature == Curvature::kConvex) {
    weights.k = chi2 > a2 ? -weights.w / chi2 : -2.0 * weights.w * weights.w / a2;
  }
  return weights;
}

}  // namespace

Vector6d RelativePoseError(const Pose& from, const Pose& to, const Pose& measured) {
  const Eigen::Quaterniond q_from_map = from.q.conjugate();
  const Eigen::Quaterniond q_meas_inverse = measured.q.conjugate();
  Vector6d error;
  error << LogSO3(Eigen::Quaterniond(q_meas_inverse * (q_from_map * to.q))),
      q_meas_inverse * (q_from_map * (to.p - from.p) - measured.p);
  return error;
}

// Perturbing `to` by d moves the error by J d, J = blockdiag(J_log, R_error). Perturbing `from` by
// d is perturbing `to` by -Ad^T d, where Ad = [I, Hat(p); 0, I] blockdiag(R, R) with (R, p) =
// T_est. So all blocks follow from that of `to`, H: Ad H Ad^T for `from`, -Ad H for the two.
EdgeModel ModelOfEdge(
    const Pose& from, const Pose& to, const Pose& measured, const Matrix6d& W, double w, double k) {
  const Eigen::Quaterniond q_est = from.q.conjugate() * to.q;
  const Eigen::Quaterniond q_error = measured.q.conjugate() * q_est;
  const Eigen::Vector3d p = from.q.conjugate() * (to.p - from.p);
  const Matrix3d R = q_est.toRotationMatrix();
  const Matrix3d R_error = q_error.toRotationMatrix();
  Vector6d error;
  error << LogSO3(q_error), measured.q.conjugate() * (p - measured.p);
  const Matrix3d J_log = RightJacobianInverseSO3(error.head<3>());

  const Vector6d We = W * error;
  Vector6d g;
  g << J_log.transpose() * We.head<3>(), R_error.transpose() * We.tail<3>();
  const Vector6d kg = k * g;
  const Matrix3d A = Product(J_log.transpose(), Product(W.topLeftCorner<3, 3>(), w * J_log)) +
                     kg.head<3>() * g.head<3>().transpose();
  const Matrix3d B = Product(J_log.transpose(), Product(W.topRightCorner<3, 3>(), w * R_error)) +
                     kg.head<3>() * g.tail<3>().transpose();
  const Matrix3d C =
      Product(R_error.transpose(), Product(W.bottomRightCorner<3, 3>(), w * R_error)) +
      kg.tail<3>() * g.tail<3>().transpose();

  EdgeModel model;
  model.to = w * g;
  model.to_to << A, B, B.transpose(), C;
  const Eigen::Vector3d force = R * model.to.tail<3>();
  model.from << -(R * model.to.head<3>() + p.cross(force)), -force;
  const Matrix3d RBt = Product(R, B.transpose());
  const Matrix3d RC = Product(R, C);
  const Matrix3d upper_left = Product(R, A) + CrossColumns(p, RBt);
  const Matrix3d upper_right = Product(R, B) + CrossColumns(p, RC);
  model.from_to << -upper_left, -upper_right, -RBt, -RC;
  const Matrix3d mixed = Product(upper_right, R.transpose());
  model.from_from << Product(upper_left, R.transpose()) +
                         CrossColumns(p, mixed.transpose()).transpose(),
      mixed, mixed.transpose(), Product(RC, R.transpose());
  return model;
}

PoseGraphObjective::PoseGraphObjective(const PoseGraph& graph) : graph_(graph) {
  free_index_.assign(graph.fixed.size(), -1);
  for (size_t i = 0; i < graph.fixed.size(); ++i) {
    if (!graph.fixed[i]) free_index_[i] = static_cast<int32_t>(num_free_++);
  }
  for (const PoseGraphEdge& edge : graph.edges) {
    const auto from = static_cast<size_t>(edge.from);
    const auto to = static_cast<size_t>(edge.to);
    edges_.push_back({from, to, ToPose(edge.T_from_to), -1, free_index_[from] < free_index_[to]});
    if (free_index_[from] < 0 || free_index_[to] < 0) continue;
    pairs_.push_back(std::minmax(free_index_[from], free_index_[to]));
  }
  std::sort(pairs_.begin(), pairs_.end());
  pairs_.erase(std::unique(pairs_.begin(), pairs_.end()), pairs_.end());
  for (Edge& edge : edges_) {
    if (free_index_[edge.from] < 0 || free_index_[edge.to] < 0) continue;
    const std::pair<int32_t, int32_t> pair =
        std::minmax(free_index_[edge.from], free_index_[edge.to]);
    edge.pair =
        static_cast<int32_t>(std::lower_bound(pairs_.begin(), pairs_.end(), pair) - pairs_.begin());
  }
}

std::vector<Pose> PoseGraphObjective::InitialPoses() const {
  std::vector<Pose> poses(graph_.T_map_body.size());
  std::transform(graph_.T_map_body.begin(), graph_.T_map_body.end(), poses.begin(), ToPose);
  return poses;
}

std::vector<double> PoseGraphObjective::Chi2(const std::vector<Pose>& poses) const {
  std::vector<double> chi2(edges_.size());
  for (size_t k = 0; k < edges_.size(); ++k) {
    const Edge& edge = edges_[k];
    const Vector6d error = RelativePoseError(poses[edge.from], poses[edge.to], edge.measured);
    chi2[k] = error.dot(graph_.edges[k].information * error);
  }
  return chi2;
}

double PoseGraphObjective::Cost(const std::vector<Pose>& poses, double cauchy_scale) const {
  const std::vector<double> chi2 = Chi2(poses);
  const double a2 = cauchy_scale * cauchy_scale;
  double sum = 0.0;
  for (size_t k = 0; k < chi2.size(); ++k) {
    sum += graph_.edges[k].robust ? a2 * std::log1p(chi2[k] / a2) : chi2[k];
  }
  return 0.5 * sum;
}

QuadraticModel PoseGraphObjective::EmptyModel() const {
  QuadraticModel model;
  model.hessian.pairs = pairs_;
  model.hessian.below.resize(pairs_.size());
  model.hessian.diagonal.resize(num_free_);
  model.gradient.resize(static_cast<Eigen::Index>(6 * num_free_));
  return model;
}

void PoseGraphObjective::Linearize(const std::vector<Pose>& poses,
                                   double cauchy_scale,
                                   Curvature curvature,
                                   QuadraticModel* model) const {
  std::fill(model->hessian.diagonal.begin(), model->hessian.diagonal.end(), Matrix6d::Zero());
  std::fill(model->hessian.below.begin(), model->hessian.below.end(), Matrix6d::Zero());
  model->gradient.setZero();
  for (size_t k = 0; k < edges_.size(); ++k) {
    const Edge& edge = edges_[k];
    const Pose& from = poses[edge.from];
    const Pose& to = poses[edge.to];
    const Matrix6d& W = graph_.edges[k].information;
    LossWeights weights;
    if (graph_.edges[k].robust) {
      const Vector6d error = RelativePoseError(from, to, edge.measured);
      weights = CauchyWeights(error.dot(W * error), cauchy_scale, curvature);
    }
    AddEdge(ModelOfEdge(from, to, edge.measured, W, weights.w, weights.k), edge, model);
  }
}

void PoseGraphObjective::AddEdge(const EdgeModel& edge_model,
                                 const Edge& edge,
                                 QuadraticModel* model) const {
  const int32_t from = free_index_[edge.from];
  const int32_t to = free_index_[edge.to];
  if (from >= 0) {
    model->hessian.diagonal[static_cast<size_t>(from)] += edge_model.from_from;
    model->gradient.segment<6>(6 * from) += edge_model.from;
  }
  if (to >= 0) {
    model->hessian.diagonal[static_cast<size_t>(to)] += edge_model.to_to;
    model->gradient.segment<6>(6 * to) += edge_model.to;
  }
  if (edge.pair < 0) return;
  Matrix6d& block = model->hessian.below[static_cast<size_t>(edge.pair)];
  if (edge.transposed) {
    block += edge_model.from_to.transpose();
  } else {
    block += edge_model.from_to;
  }
}

std::vector<Pose> PoseGraphObjective::Moved(const std::vector<Pose>& poses,
                                            const Eigen::VectorXd& step) const {
  std::vector<Pose> moved = poses;
  for (size_t i = 0; i < poses.size(); ++i) {
    if (free_index_[i] < 0) continue;
    const Vector6d xi = step.segment<6>(6 * free_index_[i]);
    moved[i].q = (poses[i].q * ExpSO3(xi.head<3>())).normalized();
    moved[i].p = poses[i].p + poses[i].q * xi.tail<3>();
  }
  return moved;
}

}  // namespace covinz
