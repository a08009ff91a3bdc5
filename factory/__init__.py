"""The data factory: it renders the records of a job with Cycles, through bpy. No torch here."""
