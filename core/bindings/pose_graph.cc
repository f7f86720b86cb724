#include "bindings.h"

namespace covinz {

void BindPoseGraph(nanobind::module_&) {}

}  // namespace covinz
