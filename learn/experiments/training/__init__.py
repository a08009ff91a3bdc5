"""What training gains by losses, shapes and renderings; normals of what was trained."""
