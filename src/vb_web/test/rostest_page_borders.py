#!/usr/bin/env python3
"""Borders drawn, edited and shown on the page."""

import numpy as np
import rospy
import rostest
from shapely.geometry import Point, Polygon

from page_rig import CARPET, PageTest, draw_carpet, overlap, run_script
from phone import PHONE
from vb_testing import assert_fields, wait_until
from vb_core import names, sentences
from vb_core.ros.messages import array_from_points
from vb_msgs.msg import VirtualBorder
from vb_msgs.srv import RemoveBorder, RenameBorder


class BordersTest(PageTest):
    def wait_mode(self, mode):
        self.browser.wait("document.body.dataset.mode == arguments[0]", mode, what=f"the mode {mode}")

    def knobs(self):
        return len(self.browser.boxes("#placed .knob"))

    def test_a_drawn_border_is_saved_in_its_place(self):
        draw_carpet(self.browser)
        self.browser.field("#review input[data-key=name]").send_keys("Küche 厨房")
        self.browser.click("#review button", "Save")
        self.wait_mode("look")
        (border,) = self.wait_borders(1)
        assert_fields(border, name="Küche 厨房", kind=VirtualBorder.POLYGON)
        area = Polygon(array_from_points(border.points))
        np.testing.assert_allclose(area.bounds, (*CARPET[0], *CARPET[2]), atol=0.1)
        self.assertTrue(area.contains(Point(border.seed.x, border.seed.y)))
        self.browser.wait("document.getElementById('restricted').classList.contains('there')", what="the restriction")
        self.browser.wait_text("#borders", "Küche 厨房")

    def test_a_border_is_undone_and_redone(self):
        self.store_carpet()
        self.browser.click("#undo")
        self.wait_borders(0)
        self.browser.wait_text("#borders", "No borders yet")
        self.browser.wait_text("#toast", "Removed from the map: Rug.")
        self.browser.click("#redo")
        self.wait_borders(1)
        self.browser.wait("document.getElementById('redo').disabled", what="a button that has nothing to do")
        self.browser.driver.refresh()  # the buttons are right without being tried
        self.browser.wait_ready()
        available = "document.getElementById('redo').disabled && !document.getElementById('undo').disabled"
        self.browser.wait(available, what="what can be undone")

    def test_a_change_of_nothing_is_not_an_undo_step(self):
        self.store_carpet()
        revision = self.browser.run("return window.virtualBorders.view.borders.revision")
        self.browser.click("#borders .name")
        self.browser.click("#dialog button", "Edit")
        self.browser.wait_text("#review", "m²")
        self.browser.click("#review button", "Save")
        self.wait_mode("look")
        self.assertEqual(self.browser.run("return window.virtualBorders.view.borders.revision"), revision)

    def test_zooming_and_turning_the_phone_keep_a_drawing(self):
        self.browser.click("#draw")
        self.browser.tap([3.0, 1.0])
        self.browser.fingers([[[3.5, 2.0]], [[3.5, 2.0], [4.0, 2.0]], [[3.4, 2.0], [4.1, 2.0]]])
        self.assertEqual(self.knobs(), 1)
        # a phone that is turned during a stroke: the line until then is not a border
        self.browser.fingers([[[3.0, 1.0]], [[3.5, 1.0]], [[4.0, 1.0]]], lift=False)
        self.browser.resize((740, 360))
        wait_until(lambda: self.knobs() == 1, "the corner from before")
        self.browser.lift()
        self.browser.resize(PHONE)
        self.wait_mode("draw")

    def test_back_closes_the_topmost_dialog_or_mode(self):
        self.browser.click("#draw")
        self.browser.tap([3.0, 1.0])
        self.browser.driver.back()
        self.browser.wait_text("#dialog", "not saved yet")
        # a dialog that opens right after another was closed keeps the page below it inert
        self.assertTrue(run_script(self.browser, "closeAndReopenDialog"))
        self.browser.click("#dialog button", "Keep editing")
        self.assertEqual(self.knobs(), 1)
        self.browser.driver.back()
        self.browser.wait_text("#dialog", "not saved yet")
        self.browser.click("#dialog button", "Discard")
        self.wait_mode("look")
        self.browser.click("#draw")
        self.browser.driver.back()
        self.wait_mode("look")  # at once: there is no corner to discard
        self.browser.click("#settings-button")
        self.browser.driver.back()
        self.browser.wait("!document.getElementById('dialog').open", what="the dialog to close")

    def test_a_covered_button_cannot_be_pressed_at_once(self):
        self.browser.click("#settings-button")
        self.assertIsNone(run_script(self.browser, "uncoverButton"))

    def test_a_double_press_asks_once(self):
        calls = run_script(self.browser, "giveCommandsAtRevisions")
        self.assertEqual({call: calls.count(call) for call in calls}, {"undo": 2, "save": 1, "stop": 3, "add": 1})
        self.browser.driver.refresh()

    def test_a_rename_after_somebody_elses_change_succeeds_on_retry(self):
        self.store_carpet()
        self.browser.click("#borders .name")
        self.browser.field("#dialog input").send_keys(" 2")
        # a typed name comes back
        self.browser.click("#dialog button", "Close")
        self.browser.click("#dialog button", "Keep editing")
        self.browser.wait_text("#dialog", "Switch off")
        self.assertEqual(self.browser.run("return document.querySelector('#dialog input').value"), "Rug 2")
        self.store_carpet("Other", "Other")
        self.browser.click("#dialog button", "Rename")
        self.browser.wait_text("#toast", "Somebody else")
        self.assertEqual(self.borders()[0].name, "Rug")
        self.browser.click("#dialog button", "Rename")
        self.browser.wait_text("#borders", "Rug 2")

    def test_an_edit_after_somebody_elses_succeeds_on_retry(self):
        self.store_carpet()
        self.browser.click("#borders .name")
        rospy.ServiceProxy(names.RENAME_BORDER, RenameBorder)(id=self.borders()[0].id, name="Mat", source="test")
        self.browser.wait_text("#borders", "Mat")
        self.browser.click("#dialog button", "Edit")
        self.browser.field("#review input").send_keys(" 3")
        self.store_carpet("Third", "Third")
        self.browser.click("#review button", "Save")
        self.browser.wait_text("#toast", "Somebody else")
        self.browser.wait_text("#review", "m²")
        self.assertEqual(self.borders()[0].name, "Mat")
        self.browser.click("#review button", "Save")
        self.browser.wait_text("#borders", "Mat 3")

    def test_an_edited_border_that_was_removed_is_saved_as_a_new_one(self):
        self.store_carpet()
        self.browser.click("#borders .name")
        self.browser.click("#dialog button", "Edit")
        self.browser.field("#review input").send_keys(" 4")
        rospy.ServiceProxy(names.REMOVE_BORDER, RemoveBorder)(id=self.borders()[0].id, source="test")
        self.browser.wait("window.virtualBorders.view.borders.list.length === 0")
        self.browser.click("#review button", "Save")
        self.browser.wait_text("#toast", "removed")
        self.browser.wait_text("#review", "m²")
        self.browser.click("#review button", "Save")
        self.browser.wait_text("#borders", "Rug 4")

    def test_late_answers_change_nothing_newer(self):
        self.store_carpet()
        previews, modes, is_dialog_open = run_script(self.browser, "answerLate")
        self.assertEqual(previews, ["Rug", "b"])
        self.assertEqual(modes, ["review", "go", "look"])
        self.assertTrue(is_dialog_open)
        self.browser.driver.refresh()

    def test_the_scale_is_true_at_each_zoom(self):
        for factor in (1, 3, 3):
            self.browser.run("window.virtualBorders.map.zoom(arguments[0])", factor)
            shown_length, true_length = run_script(self.browser, "scaleLengths")
            self.assertAlmostEqual(shown_length / true_length, 1.0, delta=0.02)
        self.browser.click("#zoom-fit")

    def test_a_drawing_shows_the_lengths_of_its_sides(self):
        self.browser.click("#draw")
        for point in ([3.0, 1.0], [5.0, 1.0], [5.0, 2.5]):
            self.browser.tap(point)
        self.assertAlmostEqual(run_script(self.browser, "shownLengths")[0], 1.5, delta=0.1)
        self.browser.click("#review button", "Remove last corner")
        self.assertEqual(self.knobs(), 2)
        self.assertAlmostEqual(run_script(self.browser, "shownLengths")[0], 2.0, delta=0.1)
        for _ in range(2):
            self.browser.click("#review button", "Remove last corner")
        self.assertEqual(self.knobs(), 0)
        buttons = "return [...document.querySelectorAll('#review button:disabled')].map((button) => button.textContent)"
        self.assertIn("Remove last corner", self.browser.run(buttons))

    def test_a_corner_that_is_chosen_shows_the_lengths_beside_it(self):
        draw_carpet(self.browser)
        self.assertEqual(run_script(self.browser, "shownLengths"), [])
        self.browser.tap(self.browser.run("return window.virtualBorders.draft().points[0]"))
        sides = run_script(self.browser, "sidesAtFirstCorner")
        np.testing.assert_allclose(sorted(run_script(self.browser, "shownLengths")), sorted(sides), atol=0.006)

    def test_the_seed_follows_each_change_of_corners(self):
        draw_carpet(self.browser)
        self.assertEqual(run_script(self.browser, "changeCorners"), [True, True, True])

    def test_a_rendered_form_keeps_caret_and_typing(self):
        draw_carpet(self.browser)
        self.assertEqual(run_script(self.browser, "renderFormAgain"), [True, "Rug", 1, 2])
        # a half-typed number
        self.browser.run("const { map, draft } = window.virtualBorders; draft().zone = 'slow'; map.on.choose(null)")
        speed = self.browser.field("#review input[type=number]")
        self.browser.run("arguments[0].select()", speed)
        speed.send_keys("0.")
        self.browser.run("window.virtualBorders.map.on.choose(1)")
        speed.send_keys("35")
        self.browser.run("arguments[0].blur()", speed)
        self.assertEqual(self.browser.run("return window.virtualBorders.draft().max_speed"), 0.35)

    def test_a_wall_with_a_warning_hides_no_name(self):
        with self.small_phone() as small:
            small.click("#wall")
            for point in ([3.2, 3.95], [3.2, 3.1]):  # a doorway
                small.tap(point)
            small.wait_text("#review", "Save this wall?")
            small.wait_text("#review", sentences.translate("splits_free_space", {}, "en"))
            small.wait_arrived()
            small.run("window.scrollTo(0, 0)")
            for part in ("input", ".issue", ".primary"):
                self.assertTrue(run_script(small, "isUncovered", f"#review {part}"), part)
            small.click("#review button", "Save")
            (wall,) = self.wait_borders(1)
            self.assertEqual(wall.kind, VirtualBorder.VIRTUAL_WALL)
            small.wait_text("#borders", "Wall ")  # unnamed

    def test_each_border_in_view_has_its_name_or_its_mark(self):
        self.browser.wait_arrived()
        lines = {"a": CARPET, "b": [[x + 0.4, y + 2.2] for x, y in CARPET]}
        lines.update((name, [[x, 2.3], [x, 3.0]]) for name, x in (("c", 3.9), ("d", 4.1), ("e", 4.3)))
        run_script(self.browser, "showBorders", lines)
        (frame,) = self.browser.boxes("#map")
        scale = self.browser.run("return window.virtualBorders.map.limits[0]")
        for factor, x, y in ((1, 4, 2.5), (1.5, 4, 2.5), (4, 4.1, 2.6), (6, 4, 1.5), (5, 1.0, 1.0), (12, 4.1, 2.0)):
            view = {"scale": scale * factor, "x": x, "y": y}
            half = [frame["width"] / view["scale"] / 2, frame["height"] / view["scale"] / 2]
            boxes = []
            for name, *shown in run_script(self.browser, "labelsInView", view):
                low, high = np.min(lines[name], axis=0), np.max(lines[name], axis=0)
                inside = bool(np.all(high > [x - half[0], y - half[1]]) and np.all(low < [x + half[0], y + half[1]]))
                self.assertEqual(len(shown), int(inside), f"{name} at {view}: {shown}")
                boxes += shown
            for number, (text, box) in enumerate(boxes):
                self.assertGreaterEqual(box["left"], frame["left"] - 1, text)
                self.assertLessEqual(box["right"], frame["right"] + 1, text)
                for other, other_box in boxes[:number]:
                    self.assertFalse(overlap(box, other_box, tolerance=1.0), f"{text} and {other} at {view}")
        self.browser.driver.refresh()
        self.browser.wait_ready()

    def test_borders_that_are_not_in_force_look_so(self):
        for name in ("On", "Off"):
            self.store_carpet(name, name)  # both in one place, with room for one name at most
        self.browser.click("#borders li:last-child .switch")
        wait_until(lambda: [border.enabled for border in self.borders()] == [True, False], "the border to be off")
        self.browser.wait_text("#borders", "Switched off")
        self.browser.wait("document.body.classList.contains('marks')", what="marks")
        for selector, properties in (
            ("#world .border", "strokeDasharray"),
            ("#placed .mark", "textDecorationLine strokeDasharray"),
            ("#borders .mark", "textDecorationLine borderTopStyle"),
        ):
            states = run_script(self.browser, "stylesOf", selector, properties.split())
            self.assertEqual([len(states), len(set(states))], [2, 2], f"{selector}: {states}")
        self.browser.click("#borders li:last-child .switch")
        wait_until(lambda: self.borders()[1].enabled, "the border to be on again")


if __name__ == "__main__":
    rostest.rosrun("vb_web", "rostest_page_borders", BordersTest)
