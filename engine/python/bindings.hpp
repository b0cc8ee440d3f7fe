// A namespace for each file of bindings: several of them are compiled as one.
#pragma once

#include <nanobind/nanobind.h>

namespace vmslam::python {

namespace association_bindings {
void bind(nanobind::module_& module);
}
namespace certificate_bindings {
void bind(nanobind::module_& module);
}
namespace edges_bindings {
void bind(nanobind::module_& module);
}
namespace factors_bindings {
void bind(nanobind::module_& module);
}
namespace filters_bindings {
void bind(nanobind::module_& module);
}
namespace gibbs_bindings {
void bind(nanobind::module_& module);
}
namespace online_bindings {
void bind(nanobind::module_& module);
}
namespace solve_bindings {
void bind(nanobind::module_& module);
}
namespace sparse_bindings {
void bind(nanobind::module_& module);
}

}  // namespace vmslam::python
