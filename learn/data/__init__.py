"""Examples to learn from and to test on: records, geometry, photographs, batches relit by the layer
or rendered by Cycles.
"""
