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

    The unknowns should be near their optimum for the present variances; they take the Gauss-Newton step of this problem, too.

    Raises:
        GraphError: the problem determines no solution, or the values became infinite.
    """
    linear = unknowns.linearized()
    names = [*unknowns.motion_parts, *unknowns.sensor_parts]
    nodes, values = linear.samples(SAMPLES, rng)
    # of each variance: its edges, C_p / u, r_p and W r_p
    terms: list[tuple[Edges, Array, Array, Array]] = []
    right, right_values = np.zeros((*linear.xi.shape, len(names))), np.zeros((len(linear.prior), len(names)))
    for edges in linear.edges:
        pulled = edges.information @ edges.residuals[:, :, None]
        for name, C in edges.parts.items():
            part = C * (np.exp(unknowns.logarithms[name]) / edges.weights)[:, None, None]
            r = part @ pulled
            weighted, k = edges.information @ r, len(terms)
            column = right[:, :, k : k + 1]
            right_values[:, k : k + 1] = edges.pull(weighted, column)
            terms.append((edges, part, r, weighted))
    solved, solved_values = linear.solve(right, right_values)
    gradient, information = np.zeros(len(names)), np.zeros((len(names), len(names)))
    for edges in linear.edges:
        rows = [k for k, term in enumerate(terms) if term[0] is edges]
        pulled = edges.information @ edges.residuals[:, :, None]
        spread = edges.information @ edges.moved(nodes, values)
        follows = edges.moved(solved, solved_values)
        for k in rows:
            _, part, r, weighted = terms[k]
            # all matrices are symmetric, so that tr(W C) is the sum of the products of their elements
            fitted = np.sum(spread * (part @ spread)) / SAMPLES
            gradient[k] = 0.5 * (np.sum(pulled * r) - np.sum(edges.information * part) + fitted)
            information[k] -= 0.5 * np.einsum("ei,eik->k", weighted[:, :, 0], follows)
            for other in rows:
                information[k, other] += 0.5 * np.sum(weighted * terms[other][2])
    prior = SPREAD**-2
    now = np.array([unknowns.logarithms[name] for name in names])
    gradient -= prior * (now - np.array([unknowns.centres[name] for name in names]))
    information = (information + information.T) / 2 + prior * np.eye(len(names))
    step = np.linalg.solve(information, gradient)
    after = now + np.clip(step, -LONGEST, LONGEST)
    unknowns.take_step(linear)
    unknowns.logarithms = dict(zip(names, after.tolist()))
    return float(gradient @ step), np.sqrt(np.diag(np.linalg.inv(information)))
