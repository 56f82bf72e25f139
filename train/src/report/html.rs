//! Text in HTML pages. File names may hold any character.

use std::fmt::Write;

use serde::Serialize;

/// Escapes text for an element, or for the value of an attribute in quotation marks.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // HTML pages cannot hold these characters.
            letter if letter.is_control() && !matches!(letter, '\n' | '\t') => {
                escaped.push(char::REPLACEMENT_CHARACTER)
            }
            letter => escaped.push(letter),
        }
    }
    escaped
}

/// Formats a value as JSON for a `script` element, which ends at the first `</script`, even inside a string.
pub fn in_script(value: &impl Serialize) -> serde_json::Result<String> {
    Ok(serde_json::to_string(value)?.replace('<', "\\u003c"))
}

/// Formats a table from titles with the classes of their columns, and rows of cells that are HTML already. The class
/// `number` aligns a column to the right.
pub fn table(titles: &[(&str, &str)], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut text = String::from("<table>\n<thead><tr>");
    for (title, class) in titles {
        // Writing to a string does not fail.
        let _ = write!(text, "<th class=\"{class}\">{title}</th>");
    }
    text.push_str("</tr></thead>\n<tbody>\n");
    for row in rows {
        text.push_str("<tr>");
        for ((_, class), cell) in titles.iter().zip(row) {
            let _ = write!(text, "<td class=\"{class}\">{cell}</td>");
        }
        text.push_str("</tr>\n");
    }
    text + "</tbody>\n</table>\n"
}

#[cfg(test)]
mod tests;
