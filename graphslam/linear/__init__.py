"""The linear algebra of Omega and xi: blocks, slots and the sparse Cholesky factor. It is independent of robots and edges."""
