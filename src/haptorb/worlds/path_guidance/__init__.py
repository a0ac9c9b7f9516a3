"""Guidance that plans: a path, its checks, and a predictive controller that holds the tool to it sideways."""
