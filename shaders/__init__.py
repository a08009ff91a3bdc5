"""The single definitions of reflectance and light, in numpy; torch tensors pass as well."""
