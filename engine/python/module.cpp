// The Python module graphslam._engine: NumPy arrays in and out, and the interpreter runs other threads meanwhile.
#include "bindings.hpp"

NB_MODULE(_engine, module) {
    // objects that live until the interpreter ends are no mistake of the user, who would see a page of warnings
    vmslam::python::nb::set_leak_warnings(false);
    module.doc() = "The engine of virtual-motion-slam; see the Python modules that use it.";
    vmslam::python::bind_association(module);
    vmslam::python::bind_certificate(module);
    vmslam::python::bind_edges(module);
    vmslam::python::bind_factors(module);
    vmslam::python::bind_filters(module);
    vmslam::python::bind_gibbs(module);
    vmslam::python::bind_online(module);
    vmslam::python::bind_sparse(module);
    vmslam::python::bind_solve(module);
}
