"""One traversal of a view and material for many lights: measured, and not chosen.

what      light adds up linearly. A view and material is rendered once under each map of a basis of
          lights, and its picture under any light is a weighted sum of these pictures. As a ratio,
          two such sums, with and without shadows and interreflection, are put in
          `ratio.multiply_by_ratio`
bias      what the basis cannot show of a light: 32 cells of the map, summed, leave 69.8 to 216 on
          three scenes and 20.8 on a matte white. Harmonics up to order 3 leave 1,810 in the mean
noise     all pictures of a view have the same, so that they are not independent training data
cost      the samples of every map of the basis once, and a sum for each picture. The ratio needs
          each light's closed form besides, which is most of what a picture of it takes
pays      from 12 to 26 pictures of a view and material, by 32 cells, at the errors above; with 64
          pictures it is then 2.5 to 5.0 times as fast as the fastest of path tracing, denoiser and
          ratio at the same error
fails     at smaller errors. The ratio of 128 cells has 12.1 in the mean, at 0.67 times the speed of
          the fastest other way for 64 pictures. Finer cells need more pictures than they save

Measured by factory.render.validation.relighting at 64², full transport, on four scenes with two of
64 lights each (docs/results/relighting-basis). It is no estimator that a job may name: a limit on
the error is asked of each picture by itself, and the errors at which it pays are above those.
"""

import numpy as np


def sum_basis_pictures(pictures: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return radiance (height, width, 3) under a light, nowhere negative.

    pictures  (B, height, width, 3) under each map of the basis, in white
    weights   (B, 3) of the light: its red, green and blue in units of each map
    """
    return np.maximum(np.einsum("bhwc,bc->hwc", pictures, weights), 0)
