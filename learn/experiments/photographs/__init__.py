"""Edits of photographs: how they are exposed, painted objects, objects in rooms."""
