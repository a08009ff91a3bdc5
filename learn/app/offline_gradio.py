"""Gradio, imported so that it sends no statistics and asks no server for anything.

Gradio reads its settings while it is imported, so that the page's modules import it from here.
"""

import os

os.environ["GRADIO_ANALYTICS_ENABLED"] = "False"
os.environ.setdefault("HF_HUB_OFFLINE", "1")

import gradio as gr

__all__ = ["gr"]
