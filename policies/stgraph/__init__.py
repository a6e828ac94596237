"""The paper's network: a heterogeneous graph attention network over spatiotemporal graphs."""
