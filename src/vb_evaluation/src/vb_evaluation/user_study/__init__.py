"""The kit for a study with people: plan, record, measure, questionnaire (docs/how-to/run-a-study.md)."""
