"""How networks learn: from demonstrations with DAgger, and by reward."""
