"""From marker tracks to the shape of the specimen: repair, frames, curves, rings."""
