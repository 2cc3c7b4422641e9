"""cGNF: the conditional graph normalizing flow, a density of 3D poses given any subset of 2D keypoints.

Letters: K nodes of the graph, P poses, n samples of each pose, D coordinates, H hidden features, C features of the
embedded context. Inside the flow tensors are node-first, (K, P, n, features): a sum over the edges is then one product
with a K x K matrix, and what depends on the keypoints alone broadcasts over the samples.

Reference: Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4 and supplement B.
"""
