"""The paper's rendering layer: pictures from normals, materials and light, differentiable in each.

n         (B, H, W, 3) normals, camera frame, unit length inside the mask; 0 in the background
material  (B, 108), or (B, S, 108) with `segments`: κ and γ control values (shaders.dsbrdf), not
          their logarithms
light     (B, Hl, Wl, 3) linear radiance, light frame (shaders.frames), any size
view      (B, H, W, 3) towards the viewer, camera frame; None: orthographic, (0, 0, 1) for every
          pixel
segments  (B, H, W) integers 1 … S, 0 in the background

    I_k(p) = Σ_i f_k(w_i, w_o, m) L_k(i) max(0, n_p·w_i) Ω_i      supplement, Eq. 8, with exact Ω_i

Pictures of one material and one light, each one tensor expanded over the batch, are one scene: some
methods then share work between them. Gradients in n and view are tangential: a normal is scaled to
unit length before use, and derivatives pass through that. Derivatives of derivatives
(create_graph=True) are given by method="exact", in every pair of arguments; a method that
approximates gives them where they are right, and raises NotImplementedError by its name where they
are requested and are not (docs/layer-in-a-model.md). Pixels whose normal does not face the viewer
(n·v ≤ learn.methods.HORIZON) come out black, with zero gradient.
"""

import torch

from learn import methods
from learn.engines import pixel_selection
from learn.layer import transforms
from learn.layer.compaction import compact_pixels
from learn.layer.inputs import check_inputs, check_settings
from shaders.frames import ELEVATION


def render(
    n: torch.Tensor,
    material: torch.Tensor,
    light: torch.Tensor,
    view: torch.Tensor | None = None,
    segments: torch.Tensor | None = None,
    mask: torch.Tensor | None = None,
    method: str = "auto",
    tolerance: float = 1e-2,
    elevation: float = float(ELEVATION),
) -> torch.Tensor:
    """Return the radiance (B, H, W, 3) that reaches the viewer; zeros outside the mask.

    n, material, light, view, segments   as above; one dtype and device (half precisions are summed
    in float32)
    mask       (B, H, W) bool; None: where n is not 0. What lies outside is never read
    method     a name of learn.methods.NAMES; "auto" chooses the cheapest that keeps the tolerance
    tolerance  relative error that "auto" may make; other methods derive their parameter from it
    elevation  radians from the light frame to the camera frame about x
               (shaders.frames.camera_from_light); 0 if the light map is in the camera's frame
    Raises     ValueError that names the argument, the rule and the value; NotImplementedError for
               derivatives that the method lacks: second ones (see above) when they are requested,
               third ones, forward mode
    Source     supplement, "Details of Rendering Layer"
    """
    if not torch.compiler.is_compiling() and transforms.are_active():
        return transforms.render(
            (n, material, light, view, segments, mask), (method, tolerance, elevation)
        )
    inputs = check_inputs(n, material, light, view, segments, mask, tolerance, elevation)
    batch, index = compact_pixels(inputs)
    chosen = methods.load(method)  # a misspelt name is refused even where nothing is to be rendered
    if batch.counts:
        work = chosen.radiance
        # planned in numpy, which torch.compile must not trace
        if torch.compiler.is_compiling() and method != "exact":
            work = torch.compiler.disable(work)
        radiance = work(batch, inputs.tolerance)
    # nothing to render, yet every argument keeps its place in the graph and gets a zero gradient
    else:
        radiance = batch.n + 0 * (
            batch.m.sum() + batch.light.sum() + (0 if batch.view is None else batch.view.sum())
        )
    picture = (
        pixel_selection.spread(radiance, index, inputs.mask.numel()).reshape(n.shape).to(n.dtype)
    )
    if picture.requires_grad and not torch.compiler.is_compiling():
        picture.register_hook(transforms.refuse_batch)
    return picture


class RenderLayer(torch.nn.Module):
    """The rendering layer, a torch module without parameters: it turns normals, a material and a
    light into a picture, and passes gradients back to all three.

    layer = RenderLayer()
    picture = layer(n, material, light)   # (B, H, W, 3), linear radiance

    n          (B, H, W, 3) unit normals, camera frame; 0 in the background
    material   (B, 108) κ and γ, that is, the exp of a label; (B, S, 108) with `segments`
    light      (B, rows, columns, 3) linear radiance, light frame, row 0 at the zenith
    method     a name of learn.methods.NAMES; "auto" chooses the cheapest that keeps the tolerance
    tolerance  relative error that "auto" may make
    elevation  radians by which the camera looks down; 0 if the light is in the camera's frame
    Raises     as `render` does, which has `view`, `segments` and `mask` as well
    """

    def __init__(
        self, method: str = "auto", tolerance: float = 1e-2, elevation: float = float(ELEVATION)
    ):
        super().__init__()
        methods.load(method)
        check_settings(tolerance, elevation)
        self.method, self.tolerance, self.elevation = method, tolerance, elevation

    def forward(
        self,
        n: torch.Tensor,
        material: torch.Tensor,
        light: torch.Tensor,
        view: torch.Tensor | None = None,
        segments: torch.Tensor | None = None,
        mask: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Return the picture (B, H, W, 3); all arguments are those of `render`."""
        return render(
            n, material, light, view, segments, mask, self.method, self.tolerance, self.elevation
        )

    def extra_repr(self) -> str:
        """Return the settings, for torch's printed form."""
        return (
            f"method={self.method!r}, tolerance={float(self.tolerance):g},"
            f" elevation={float(self.elevation):.4f}"
        )
