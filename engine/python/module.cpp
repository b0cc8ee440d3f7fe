// The Python module graphslam._engine: NumPy arrays in and out, and the interpreter runs other threads meanwhile.
#include "bindings.hpp"

NB_MODULE(_engine, module) {
    // objects that live until the interpreter ends are no mistake of the user, who would see a page of warnings
    nanobind::set_leak_warnings(false);
    module.doc() = "The engine of virtual-motion-slam; see the Python modules that use it.";
#define VMSLAM_BIND(name) vmslam::python::name##_bindings::bind(module);
    VMSLAM_BINDINGS(VMSLAM_BIND)
}
