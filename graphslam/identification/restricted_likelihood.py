"""Variances by restricted maximum likelihood: one step of the average-information method.

With y the measurements, P = W - W B Omega^-1 B' W and r_p = C_p W e, the derivative of the restricted log likelihood by a
variance theta_p and the average of its observed and expected information are

    g_p = 1/2 (e' W C_p W e - tr(P C_p)),     A_pq = 1/2 r_p' P r_q.

A_pq takes one solution of the normal equations for each variance. The trace is the mean over random samples s from the
covariance of the solution: tr(P C_p) = tr(W C_p) - E[(B s)' W C_p W (B s)]. Weights of Student's t act as W = u C^-1, and
so C_p becomes C_p / u. The variables are the logarithms of the variances, with a normal prior, so that a variance that the
log does not tell stays at its typical value.

Sources: Gilmour, Thompson and Cullis, *Average information REML*, Biometrics 51(4), 1995; Hutchinson, *A stochastic estimator
of the trace of the influence matrix*, Communications in Statistics 18(3), 1989.
"""

from __future__ import annotations

import numpy as np

from ..se2 import Array
from .unknowns import SPREAD, Edges, Unknowns

#: samples for the traces
SAMPLES = 8
#: the most that the logarithm of a variance changes in one step
LONGEST = 1.5


def improve_variances(unknowns: Unknowns, rng: np.random.Generator) -> tuple[float, Array]:
    """Take one step of the variances: the predicted gain of the log likelihood, and the standard errors of the logarithms.

    The unknowns should be at their optimum for the present variances.

    Raises:
        GraphError: the problem determines no solution.
    """
    linear = unknowns.linearized()
    names = [*unknowns.motion_parts, *unknowns.sensor_parts]
    nodes, values = linear.samples(SAMPLES, rng)
    terms: list[tuple[Edges, Array, Array]] = []
    right, right_values = np.zeros((*linear.xi.shape, len(names))), np.zeros((len(linear.prior), len(names)))
    for edges in linear.edges:
        pulled = np.einsum("eij,ej->ei", edges.information, edges.residuals)
        for name, C in edges.parts.items():
            part = np.exp(unknowns.logarithms[name]) * C / edges.weights[:, None, None]
            k, r = len(terms), np.einsum("eij,ej->ei", part, pulled)
            column = right[:, :, k : k + 1]
            right_values[:, k : k + 1] = edges.pull((edges.information @ r[:, :, None]), column)
            terms.append((edges, part, r))
    solved, solved_values = linear.solve(right, right_values)
    gradient, information = np.zeros(len(names)), np.zeros((len(names), len(names)))
    for edges in linear.edges:
        rows = [k for k, term in enumerate(terms) if term[0] is edges]
        pulled = np.einsum("eij,ej->ei", edges.information, edges.residuals)
        spread = edges.information @ edges.moved(nodes, values)
        follows = edges.moved(solved, solved_values)
        for k in rows:
            _, part, r = terms[k]
            fitted = np.einsum("eis,eij,ejs->", spread, part, spread, optimize=True) / SAMPLES
            whole = np.einsum("eij,eji->", edges.information, part)
            gradient[k] = 0.5 * (np.einsum("ei,eij,ej->", pulled, part, pulled) - whole + fitted)
            weighted = np.einsum("eij,ej->ei", edges.information, r)
            information[k] -= 0.5 * np.einsum("ei,eik->k", weighted, follows)
            for other in rows:
                information[k, other] += 0.5 * np.sum(weighted * terms[other][2])
    prior = SPREAD**-2
    now = np.array([unknowns.logarithms[name] for name in names])
    gradient -= prior * (now - np.array([unknowns.centres[name] for name in names]))
    information = (information + information.T) / 2 + prior * np.eye(len(names))
    step = np.linalg.solve(information, gradient)
    after = now + np.clip(step, -LONGEST, LONGEST)
    unknowns.logarithms = dict(zip(names, after.tolist()))
    return float(gradient @ step), np.sqrt(np.diag(np.linalg.inv(information)))
