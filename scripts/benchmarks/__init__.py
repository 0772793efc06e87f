"""Speed of the paths that every byte or sample takes; see docs/appendix/performance-details.md."""
