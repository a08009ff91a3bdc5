"""From a job to its shots: names, assets, ids and a forecast. Nothing is rendered here but the
forecast's probe.
"""
