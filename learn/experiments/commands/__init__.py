"""The experiments as commands: one module each, as manifests.cli describes them."""
