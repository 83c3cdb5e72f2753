"""Results for people and other tools: folders, figures, reports, exports."""
