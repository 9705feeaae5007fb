#include "shading/recorded_kernels.h"

namespace fr {

namespace recorded {
void addArithmeticKernels(KernelTable&);
void addGeometryKernels(KernelTable&);
void addNoiseKernels(KernelTable&);

namespace {
thread_local ValueGraph* theGraph = nullptr;
}
ValueGraph& graph();
ValueGraph& graph() { return *theGraph; }
}  // namespace recorded

RecordingScope::RecordingScope(ValueGraph& graph) : before_(recorded::theGraph) {
  recorded::theGraph = &graph;
}
RecordingScope::~RecordingScope() { recorded::theGraph = before_; }

const recorded::KernelTable& recordedKernels() {
  static const recorded::KernelTable table = [] {
    recorded::KernelTable t;
    recorded::addArithmeticKernels(t);
    recorded::addGeometryKernels(t);
    recorded::addNoiseKernels(t);
    return t;
  }();
  return table;
}

}  // namespace fr
