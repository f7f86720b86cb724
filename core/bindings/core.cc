// The Python module covinz_core._core.
#include <opencv2/core.hpp>

#include "bindings.h"

NB_MODULE(_core, m) {
  m.doc() = "Numeric core of covinz: numbers in, numbers out.";
  // A machine's cores go to as many worker processes; OpenCV would start threads in each of them.
  cv::setNumThreads(1);
  covinz::BindLoopGeometry(m);
  covinz::BindMatching(m);
  covinz::BindFastLoop(m);
  covinz::BindOdometry(m);
  covinz::BindPlaceRecognition(m);
  covinz::BindPoseGraph(m);
  covinz::BindRigNeighbours(m);
}
