package gluerl;

import java.util.ArrayList;
import java.util.LinkedHashMap;
import java.util.List;
import java.util.Map;

/** As much of JSON as vectors.json needs: objects, arrays, texts, whole numbers, booleans and null. */
final class Json {
    private final String text;
    private int at;

    private Json(String text) {
        this.text = text;
    }

    /** Returns Maps, Lists, Strings, Longs, Booleans and nulls. */
    static Object parse(String text) {
        return new Json(text).value();
    }

    private Object value() {
        char first = peek();
        switch (first) {
            case '{':
                Map<String, Object> object = new LinkedHashMap<>();
                for (at++; peek() != '}'; skip(',')) {
                    String key = string();
                    skip(':');
                    object.put(key, value());
                }
                at++;
                return object;
            case '[':
                List<Object> array = new ArrayList<>();
                for (at++; peek() != ']'; skip(',')) {
                    array.add(value());
                }
                at++;
                return array;
            case '"':
                return string();
            case 't', 'f', 'n':
                String word = first == 't' ? "true" : first == 'f' ? "false" : "null";
                at += word.length();
                return first == 'n' ? null : (Object) (first == 't');
            default:
                int start = at;
                while (text.charAt(at) == '-' || Character.isDigit(text.charAt(at))) {
                    at++;
                }
                return Long.parseLong(text.substring(start, at));
        }
    }

    private String string() {
        peek();
        StringBuilder result = new StringBuilder();
        for (at++; text.charAt(at) != '"'; at++) {
            char c = text.charAt(at);
            if (c == '\\') {
                c = text.charAt(++at);
                if (c == 'u') {
                    c = (char) Integer.parseInt(text.substring(at + 1, at + 5), 16);
                    at += 4;
                } else {
                    c = "\b\f\n\r\t".charAt("bfnrt".indexOf(c) < 0 ? 0 : "bfnrt".indexOf(c));
                    c = "\"\\/".indexOf(text.charAt(at)) < 0 ? c : text.charAt(at);
                }
            }
            result.append(c);
        }
        at++;
        return result.toString();
    }

    private char peek() {
        while (Character.isWhitespace(text.charAt(at))) {
            at++;
        }
        return text.charAt(at);
    }

    private void skip(char c) {
        if (peek() == c) {
            at++;
        }
    }
}
