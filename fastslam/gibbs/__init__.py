"""The Rao-Blackwellised particle smoother: particle Gibbs on whole trajectories, with the landmarks integrated out.

`chains.ParticleGibbs` is the sampler. The kernels: `pivots` and `paths` renew the trajectory, `maps` holds the algebra of
landmarks, `exact` corrects for the linearisation of the sightings. `sightings` prepares a log, `mixing` judges the chains.
"""
