"""Parameters of vehicle and sensor as unknowns of a graph, such as the scale of the wheels."""

from .declared import PARAMETERS, Parameter, ParameterEstimate, Parameters

__all__ = ["PARAMETERS", "Parameter", "ParameterEstimate", "Parameters"]
