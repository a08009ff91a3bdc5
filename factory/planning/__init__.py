"""From a job to its shots: names, assets, ids and draws. Nothing is rendered here."""
