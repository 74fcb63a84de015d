"""Chains of links that turn in one plane: free or driven at the joints, from a base that stands still or moves."""
