"""Examples for training and tests: records, geometry, photographs, relit and rendered batches."""
