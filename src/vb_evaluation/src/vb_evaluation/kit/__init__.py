"""For a study with people: plan, record, measure, replay, questionnaire (docs/study.md)."""
