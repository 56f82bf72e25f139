use super::*;

#[test]
fn nothing_in_a_name_is_markup() {
    assert_eq!(escape("<script>'a'&\"b\"</script>"), "&lt;script&gt;&#39;a&#39;&amp;&quot;b&quot;&lt;/script&gt;");
    assert_eq!(escape("häuschen 1.jpg"), "häuschen 1.jpg");
    assert_eq!(escape("a\0b\u{1b}"), "a\u{fffd}b\u{fffd}");
    let name = "</script><!--";
    let text = in_script(&[name]).unwrap();
    assert!(!text.contains('<'), "{text}");
    assert_eq!(serde_json::from_str::<Vec<String>>(&text).unwrap(), [name]);
}

#[test]
fn tables_have_a_cell_per_title() {
    let text = table(&[("a", ""), ("b", "number")], [vec!["1".into(), "2".into()]]);
    assert!(text.contains("<th class=\"number\">b</th>") && text.contains("<td class=\"number\">2</td>"));
}
