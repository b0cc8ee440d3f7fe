// The Python module graphslam._engine: NumPy arrays in and out, and the interpreter runs other threads meanwhile.
#include "bindings.hpp"

NB_MODULE(_engine, module) {
    // objects that live until the interpreter ends are no mistake of the user, who would see a page of warnings
    vmslam::python::nb::set_leak_warnings(false);
    module.doc() = "The engine of virtual-motion-slam; see the Python modules that use it.";
    vmslam::python::association_bindings::bind(module);
    vmslam::python::certificate_bindings::bind(module);
    vmslam::python::edges_bindings::bind(module);
    vmslam::python::factors_bindings::bind(module);
    vmslam::python::filters_bindings::bind(module);
    vmslam::python::gibbs_bindings::bind(module);
    vmslam::python::online_bindings::bind(module);
    vmslam::python::sparse_bindings::bind(module);
    vmslam::python::solve_bindings::bind(module);
}
