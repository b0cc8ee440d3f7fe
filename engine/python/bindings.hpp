#pragma once

#include <nanobind/nanobind.h>

namespace vmslam::python {

void bind_association(nanobind::module_& module);
void bind_certificate(nanobind::module_& module);
void bind_edges(nanobind::module_& module);
void bind_factors(nanobind::module_& module);
void bind_filters(nanobind::module_& module);
void bind_gibbs(nanobind::module_& module);
void bind_online(nanobind::module_& module);
void bind_solve(nanobind::module_& module);
void bind_sparse(nanobind::module_& module);

}  // namespace vmslam::python
