"""model_comparison."""
