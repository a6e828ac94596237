"""Learned policies: networks, their training, their model folders. Only this package uses torch."""
