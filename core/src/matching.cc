#include "covinz/matching.h"

#include <stdexcept>

#include <opencv2/features2d.hpp>

namespace covinz {
namespace {

cv::Mat AsMat(const Descriptors& descriptors) {
  // OpenCV reads through a pointer that it declares mutable.
  return cv::Mat(static_cast<int>(descriptors.rows()), static_cast<int>(descriptors.cols()),
                 CV_8UC1, const_cast<uint8_t*>(descriptors.data()));
}

// Matches of the query rows that pass the ratio test, one direction.
std::vector<cv::DMatch> MatchOneWay(const cv::BFMatcher& matcher,
                                    const cv::Mat& query,
                                    const cv::Mat& cand,
                                    const MatchingOptions& options) {
  std::vector<std::vector<cv::DMatch>> neighbours;
  matcher.knnMatch(query, cand, neighbours, 2);
  std::vector<cv::DMatch> matches;
  for (const std::vector<cv::DMatch>& best : neighbours) {
    if (best.empty() || best[0].distance > options.max_distance) continue;
    const bool distinct =
        options.max_ratio >= 1.0 ||
        (best.size() == 2 && best[0].distance < options.max_ratio * best[1].distance);
    if (distinct) matches.push_back(best[0]);
  }
  return matches;
}

// Drops the matches whose candidate descriptor has another nearest query descriptor. Only those
// candidates are matched back, which gives the same as matching all of them.
std::vector<cv::DMatch> KeepMutual(const cv::BFMatcher& matcher,
                                   const cv::Mat& query,
                                   const cv::Mat& cand,
                                   const std::vector<cv::DMatch>& matches) {
  if (matches.empty()) return {};
  cv::Mat matched_cand;
  for (const cv::DMatch& match : matches) matched_cand.push_back(cand.row(match.trainIdx));
  std::vector<cv::DMatch> back;
  matcher.match(matched_cand, query, back);
  std::vector<cv::DMatch> mutual;
  for (size_t i = 0; i < matches.size(); ++i) {
    if (back[i].trainIdx == matches[i].queryIdx) mutual.push_back(matches[i]);
  }
  return mutual;
}

}  // namespace

void MatchingOptions::Check() const {
  if (!(max_ratio > 0.0 && max_ratio <= 1.0)) {
    throw std::invalid_argument("MatchingOptions.max_ratio must be in (0, 1]");
  }
  if (!(max_distance >= 0.0)) {
    throw std::invalid_argument("MatchingOptions.max_distance must not be negative");
  }
}

std::vector<Match> MatchDescriptors(const Descriptors& query,
                                    const Descriptors& cand,
                                    const MatchingOptions& options) {
  options.Check();
  if (query.rows() == 0 || cand.rows() == 0) return {};
  if (query.cols() != cand.cols()) {
    throw std::invalid_argument("descriptors differ in length: " + std::to_string(query.cols()) +
                                " and " + std::to_string(cand.cols()) + " bytes");
  }
  const cv::BFMatcher matcher(options.norm == DescriptorNorm::kHamming ? cv::NORM_HAMMING
                                                                       : cv::NORM_L2);
  std::vector<cv::DMatch> found = MatchOneWay(matcher, AsMat(query), AsMat(cand), options);
  if (options.mutual) found = KeepMutual(matcher, AsMat(query), AsMat(cand), found);
  std::vector<Match> matches;
  matches.reserve(found.size());
  for (const cv::DMatch& match : found) matches.push_back({match.queryIdx, match.trainIdx});
  return matches;
}

}  // namespace covinz
