"""Drawing: colours, labels, legends, and reading of photographs."""
