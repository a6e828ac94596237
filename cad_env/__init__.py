"""Connected autonomous driving."""
