"""The Rao-Blackwellised particle smoother: particle Gibbs on whole trajectories, with the landmarks integrated out.

`chains.ParticleGibbs` is the sampler; its sweeps are in the engine (`engine/include/vmslam/gibbs`). `chains.GibbsResult`
measures whether the chains have mixed.
"""
