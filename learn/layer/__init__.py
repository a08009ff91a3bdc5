"""The paper's rendering layer: `render`, and `RenderLayer` for use inside a network."""

from learn.layer.rendering import RenderLayer, render

__all__ = ["RenderLayer", "render"]
