"""For a study with people: plan, record, measure, replay, questionnaire (docs/how-to/run-a-study.md)."""
