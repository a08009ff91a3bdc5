"""Edits of photographs: their exposure, masks, painted objects, objects in rooms."""
