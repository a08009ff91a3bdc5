"""The layout of the kernels' tables: rows, strides, tiles and chunks.

Kernels and the code that fills their tables import the same names. numba compiles global integers
in as constants. This module needs neither numba nor numpy.

A row is LANES floats side by side, one for each light (or sample) of a block. Row numbers count
within a block, so row R of the block that begins at float `o` begins at `o + LANES * R`. A vector
takes three rows in the order x, y, z. Strides are in floats.
"""

LANES = 16

# Lights of a distant viewer: w, h, and what rounding to float32 took off h.
W_X, W_Y, W_Z, H_X, H_Y, H_Z, H_REST_X, H_REST_Y, H_REST_Z = range(9)
DISTANT_ROWS = 9
DISTANT_STRIDE = LANES * DISTANT_ROWS

# Lights of a view per pixel: w in the same rows as above, and what rounding took off w.
W_REST_X, W_REST_Y, W_REST_Z = range(3, 6)
GENERAL_ROWS = 6
GENERAL_STRIDE = LANES * GENERAL_ROWS

# Energy: a row for each channel. Sums by n, by v, and by radiance have the same shape.
ENERGY_STRIDE = LANES * 3

# Lobes at each light: (lobe, channel, (γ, κ log2 e)).
GAMMA, KAPPA = range(2)
CHANNEL_STRIDE = LANES * 2
LOBE_STRIDE = CHANNEL_STRIDE * 3
LOBES_STRIDE = LOBE_STRIDE * 3

# Control values of a material (lobe, channel, (γ, κ), 6), and the slopes of its splines (…, 5).
CONTROL_VALUES = 6
BASIS_STRIDE = LANES * CONTROL_VALUES  # of the spline's basis at each light's θ_d
KAPPA_VALUES = CONTROL_VALUES  # κ's control values lie behind γ's
CHANNEL_VALUES = 2 * CONTROL_VALUES
LOBE_VALUES = 3 * CHANNEL_VALUES
VALUES = 3 * LOBE_VALUES
STEPS_OF_CURVE = CONTROL_VALUES - 1
STEPS = 3 * 3 * 2 * STEPS_OF_CURVE

# Cones about a block's lights, one lane per block: the cone about w (axis, cosine and sine of its
# half angle), the one about h, the energy in the brightest channel, and of each of at most three
# lobes the least γ and the largest κ log2 e.
CONE_W_X, CONE_W_Y, CONE_W_Z, CONE_W_COS, CONE_W_SIN = range(5)
CONE_H_X, CONE_H_Y, CONE_H_Z, CONE_H_COS, CONE_H_SIN = range(5, 10)
CONE_ENERGY = 10
CONE_GAMMA = 11
CONE_KAPPA = 14
CONE_ROWS = 17
CONE_STRIDE = LANES * CONE_ROWS

# Scratch of culled_lists.select for sixteen blocks: of each lobe the bound, then the weight and
# later the cut. When the cuts are known, the first lobe's bound gives way to the least cosine with
# the axis.
SELECT_BOUND, SELECT_REACH, SELECT_WEIGHT = 0, 0, 3
SELECT_ROWS = 6
SELECT_STRIDE = LANES * SELECT_ROWS

# A list entry's cuts: one per lobe, then the least cosine with the axis of the cone about h.
CUTS = 4
CUT_REACH = 3

# The same for a view per pixel (learn.engines.viewed_lists): of each lobe also the least γ and the
# largest κ log2 e, then the place of θ_d in the table of these, and the half angle of the cone
# about a pixel's h. An entry's cuts hold the axis of the cone about w besides.
SELECT_GAMMA, SELECT_KAPPA, SELECT_THETA = 6, 9, 12
SELECT_H_COS, SELECT_H_SIN = 13, 14
SELECT_VIEW_ROWS = 15
SELECT_VIEW_STRIDE = LANES * SELECT_VIEW_ROWS
CUT_AXIS = 4
VIEW_CUTS = 8
THETA_BINS = 64  # of θ_d from 0 to π/2

# A lobe and channel of one run of pixels (learn.engines.view_runs): γ and its slope by the spline's
# x, κ log2 e and its slope; the sums have the same rows.
RUN_GAMMA, RUN_GAMMA_SLOPE, RUN_KAPPA, RUN_KAPPA_SLOPE = range(4)
RUN_CHANNEL_STRIDE = LANES * 4
RUN_LOBE_STRIDE = 3 * RUN_CHANNEL_STRIDE

# Samples of the quadrature about the z axis: half vector, log2 cos θ, solid angle.
SAMPLE_X, SAMPLE_Y, SAMPLE_Z, SAMPLE_LOG_COSINE, SAMPLE_SOLID_ANGLE = range(5)
SAMPLE_ROWS = 5
SAMPLE_STRIDE = LANES * SAMPLE_ROWS
# Their scratch: f μ dω by channel, the border's row and column, and the share beyond it.
FOOTPRINT_ROW, FOOTPRINT_COLUMN, FOOTPRINT_BELOW, FOOTPRINT_RIGHT = range(3, 7)
FOOTPRINT_ROWS = 7
# In the backward pass also the light seen by channel, behind them the sums by n, by v and by m.
FOOTPRINT_LIGHT = FOOTPRINT_ROWS
FOOTPRINT_BY_N = FOOTPRINT_LIGHT + 3
FOOTPRINT_BY_V = FOOTPRINT_BY_N + 3
FOOTPRINT_BY_M = FOOTPRINT_BY_V + 3

# Pixels that are summed together, by kernel.
DISTANT_TILE = 32  # they share a block of lights in the first-level cache
GENERAL_TILE = 32
CULLED_TILE = 64  # at most: they share a list
SAMPLE_TILE = 16

# Parts of the backward passes' work, which are also the most threads that they can use. They never
# depend on the number of threads, so that sums come out the same.
LIGHT_CHUNKS = 16
CULLED_CHUNKS = 4  # of tiles
MAP_CHUNKS = 4  # of pixels
SAMPLE_CHUNKS = 8  # of pixels; each has a map of its own for the derivative by light

# Scratch, in floats: for the sums of one tile and, in the backward passes, of one chunk.
DISTANT_SCRATCH = ENERGY_STRIDE * DISTANT_TILE
GENERAL_SCRATCH = 2 * ENERGY_STRIDE * GENERAL_TILE + LANES * VALUES  # by n, by v, by m
CULLED_NORMALS = ENERGY_STRIDE * CULLED_TILE  # behind the sums: normals (3, tile)
CULLED_SCRATCH = CULLED_NORMALS + 3 * CULLED_TILE
# The same for a view per pixel (learn.engines.view_runs). Behind a tile's sums and normals: its
# views less those of their runs, and the squares of these (4, tile); the views of runs, and all
# views (3, tile each); sums by v. For one run and block: the lobes and their slopes, the spline's
# basis and its slopes, and sums by the lobes and by their slopes.
VIEW_OFFSETS = CULLED_SCRATCH
VIEW_CENTRES = VIEW_OFFSETS + 4 * CULLED_TILE
VIEW_VIEWS = VIEW_CENTRES + 3 * CULLED_TILE
VIEW_V_SUMS = VIEW_VIEWS + 3 * CULLED_TILE
VIEW_LOBES = VIEW_V_SUMS + ENERGY_STRIDE * CULLED_TILE
VIEW_BASIS = VIEW_LOBES + 2 * LOBES_STRIDE
VIEW_LOBE_SUMS = VIEW_BASIS + 2 * BASIS_STRIDE
VIEW_SCRATCH = VIEW_LOBE_SUMS + 2 * LOBES_STRIDE
# Second derivatives: rows of a pixel's sums (by n, by g; by n, by v, by g), and those by m.
DISTANT_SECOND_ROWS = 6
GENERAL_SECOND_ROWS = 9
DISTANT_SECOND_SCRATCH = LANES * DISTANT_SECOND_ROWS * DISTANT_TILE
SAMPLE_SCRATCH = LANES * (FOOTPRINT_BY_M + VALUES)
GENERAL_SECOND_SCRATCH = LANES * (GENERAL_SECOND_ROWS * GENERAL_TILE + VALUES + STEPS)

# A kernel leaves a lobe out where log2 of its height, relative to its peak, is below this.
NEGLIGIBLE = -40.0

# States of a pixel (learn.engines.pixels). AWAY: inside the mask, facing away from the viewer.
# WRONG: inside the mask, a vector whose length is not close to 1, or NaN.
OUTSIDE, AWAY, SEEN, WRONG = range(4)
SHORTEST = 1e-12  # as torch.nn.functional.normalize: a vector of length 0 stays 0
