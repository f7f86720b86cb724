// The Python module covinz_core._core.
#include "bindings.h"

NB_MODULE(_core, m) {
  m.doc() = "Numeric core of covinz: numbers in, numbers out.";
  covinz::BindLoopGeometry(m);
  covinz::BindPlaceRecognition(m);
  covinz::BindPoseGraph(m);
}
