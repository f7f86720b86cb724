// Python: Vocabulary, InvertedIndex, TfIdfIndex.
#include <stdexcept>
#include <string>
#include <vector>

#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include "bindings.h"
#include "covinz/inverted_index.h"
#include "covinz/residual_index.h"
#include "covinz/tf_idf_index.h"
#include "covinz/vocabulary.h"
#include "covinz/vocabulary_training.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace covinz {
namespace {

template <typename Scalar>
using In = nb::ndarray<const Scalar, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using InDescriptors = nb::ndarray<const uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
template <typename Scalar>
using Out = nb::ndarray<nb::numpy, Scalar, nb::ndim<1>, nb::c_contig>;

template <typename Scalar>
Out<Scalar> ToNumpy(std::vector<Scalar> values) {
  auto* owned = new std::vector<Scalar>(std::move(values));
  nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<Scalar>*>(p); });
  return Out<Scalar>(owned->data(), {owned->size()}, owner);
}

template <typename Scalar>
std::vector<Scalar> ToVector(const In<Scalar>& array) {
  return std::vector<Scalar>(array.data(), array.data() + array.shape(0));
}

template <typename Descriptor>
std::vector<Descriptor> ToDescriptors(const InDescriptors& array) {
  if (array.shape(1) != sizeof(Descriptor)) {
    throw std::invalid_argument("Descriptors must have " + std::to_string(sizeof(Descriptor)) +
                                " bytes, not " + std::to_string(array.shape(1)));
  }
  return DescriptorsFromBytes<Descriptor>(array.data(), array.shape(0));
}

template <typename Descriptor>
BasicVocabulary<Descriptor> Train(const InDescriptors& descriptors,
                                  const In<int64_t>& image_offsets,
                                  int branching,
                                  int depth,
                                  uint64_t seed,
                                  int max_iterations) {
  const std::vector<Descriptor> all = ToDescriptors<Descriptor>(descriptors);
  const std::vector<int64_t> offsets = ToVector(image_offsets);
  nb::gil_scoped_release release;
  return TrainVocabulary(all, offsets, {branching, depth, max_iterations, seed});
}

constexpr size_t kDigestBytes = 32;

nb::object Sha256(const nb::bytes& content) {
  return nb::module_::import_("hashlib").attr("sha256")(content);
}

template <typename Vocabulary>
nb::bytes Content(const Vocabulary& vocabulary) {
  const std::vector<uint8_t> bytes = vocabulary.ToBytes();
  return nb::bytes(bytes.data(), bytes.size());
}

template <typename Vocabulary>
nb::bytes VocabularyBytes(const Vocabulary& vocabulary) {
  const nb::bytes content = Content(vocabulary);
  return nb::cast<nb::bytes>(content + Sha256(content).attr("digest")());
}

template <typename Vocabulary>
Vocabulary VocabularyFromBytes(const nb::bytes& bytes) {
  if (bytes.size() < kDigestBytes) throw std::invalid_argument("Vocabulary bytes: too short");
  const auto* data = static_cast<const uint8_t*>(bytes.data());
  const nb::bytes content(data, bytes.size() - kDigestBytes);
  const nb::bytes digest(data + content.size(), kDigestBytes);
  if (!Sha256(content).attr("digest")().equal(digest)) {
    throw std::invalid_argument("Vocabulary bytes: checksum differs");
  }
  return Vocabulary::FromBytes(data, content.size());
}

template <typename Descriptor>
Out<uint32_t> Words(const BasicVocabulary<Descriptor>& vocabulary, const InDescriptors& array) {
  const std::vector<Descriptor> descriptors = ToDescriptors<Descriptor>(array);
  std::vector<uint32_t> words;
  {
    nb::gil_scoped_release release;
    words = vocabulary.Words(descriptors);
  }
  return ToNumpy(std::move(words));
}

template <typename Index, typename Descriptor>
uint32_t AddToIndex(Index& index, const In<uint32_t>& words, const InDescriptors& array) {
  return index.Add(ToVector(words), ToDescriptors<Descriptor>(array));
}

template <typename Index, typename Descriptor>
Out<float> Votes(const Index& index, const In<uint32_t>& words, const InDescriptors& array) {
  return ToNumpy(index.Votes(ToVector(words), ToDescriptors<Descriptor>(array)));
}

template <typename Descriptor>
void BindVocabulary(nb::module_& m, const char* name, const char* doc) {
  using Vocabulary = BasicVocabulary<Descriptor>;
  const VocabularyTrainingOptions defaults;
  nb::class_<Vocabulary>(m, name, doc)
      .def_static("train", &Train<Descriptor>, "descriptors"_a, "image_offsets"_a, nb::kw_only(),
                  "branching"_a = defaults.branching, "depth"_a = defaults.depth,
                  "seed"_a = defaults.seed, "max_iterations"_a = defaults.max_num_iterations,
                  R"(Train by hierarchical clustering; the same input gives the same bits.

Args:
    descriptors: Descriptors (N, B) of all images, image after image.
    image_offsets: First descriptor of each image, then N: (I + 1,), for the idf weights.
    branching: Clusters per node, 2 to 255.
    depth: Levels; there are at most branching ** depth words.
    seed: Of the draws that seed the clusters.
    max_iterations: Rounds per node.

Raises:
    ValueError: Descriptors of another length, none at all, offsets that do not ascend from 0
        to N, or options out of range.)")
      .def_static("from_bytes", &VocabularyFromBytes<Vocabulary>, "data"_a,
                  "Inverse of to_bytes. Raises ValueError on truncated or altered bytes, and on a "
                  "vocabulary of another kind.")
      .def("to_bytes", &VocabularyBytes<Vocabulary>,
           "Portable bytes: kind, content and the SHA-256 of both.")
      .def("words", &Words<Descriptor>, "descriptors"_a,
           "Word (N,) of each descriptor (N, B). Raises ValueError on another length.")
      .def_prop_ro("num_words", &Vocabulary::num_words)
      .def_prop_ro(
          "idf", [](const Vocabulary& vocabulary) { return ToNumpy(vocabulary.idf()); },
          nb::rv_policy::automatic,
          "log(training images / images that hold the word) of each word: (num_words,).")
      .def_prop_ro(
          "hash",
          [](const Vocabulary& vocabulary) {
            return nb::cast<std::string>(Sha256(Content(vocabulary)).attr("hexdigest")());
          },
          "Identity: SHA-256 of the content, 64 hex digits.");
}

void BindIndices(nb::module_& m) {
  nb::class_<InvertedIndex>(m, "InvertedIndex",
                            R"(Keyframes ranked by Hamming-verified votes under common words.

One thread owns an index.)")
      .def(nb::init<int>(), "max_hamming"_a = InvertedIndex::kDefaultMaxHamming)
      .def("add", &AddToIndex<InvertedIndex, BinaryDescriptor>, "words"_a, "descriptors"_a,
           "Add a keyframe by its words (N,) and descriptors (N, 32); returns its index.")
      .def("votes", &Votes<InvertedIndex, BinaryDescriptor>, "words"_a, "descriptors"_a,
           R"(Votes (size,) of the query's descriptors (N, 32) with words (N,).

A descriptor votes once for each keyframe that holds one within max_hamming bits under the
same word, with weight log(size / keyframes hit). Raises ValueError if lengths differ.)")
      .def_prop_ro("size", &InvertedIndex::size, "Number of keyframes.")
      .def("__len__", &InvertedIndex::size);
  nb::class_<ResidualIndex>(
      m, "ResidualIndex",
      R"(Keyframes of 128-byte descriptors, ranked by votes under common words.

A descriptor's code says which of its components are above those of its word's centroid. One
thread owns an index.)")
      .def(nb::init<const ByteVocabulary&, int>(), "vocabulary"_a,
           "max_hamming"_a = ResidualIndex::kDefaultMaxHamming)
      .def("add", &AddToIndex<ResidualIndex, ByteDescriptor>, "words"_a, "descriptors"_a,
           "Add a keyframe by its words (N,) and descriptors (N, 128); returns its index.")
      .def("votes", &Votes<ResidualIndex, ByteDescriptor>, "words"_a, "descriptors"_a,
           R"(Votes (size,) of the query's descriptors (N, 128) with words (N,).

As those of InvertedIndex, over codes of 128 bits. Raises ValueError if lengths differ or a word
is not in the vocabulary.)")
      .def_prop_ro("size", &ResidualIndex::size, "Number of keyframes.")
      .def("__len__", &ResidualIndex::size);
  nb::class_<TfIdfIndex>(m, "TfIdfIndex",
                         R"(Keyframes ranked by the L1 score of tf-idf bags: the paper's score.

One thread owns an index.)")
      .def(nb::init<const Vocabulary&>(), "vocabulary"_a)
      .def(nb::init<const ByteVocabulary&>(), "vocabulary"_a)
      .def(
          "add",
          [](TfIdfIndex& index, const In<uint32_t>& words) { return index.Add(ToVector(words)); },
          "words"_a, "Add a keyframe by its words (N,); returns its index.")
      .def(
          "scores",
          [](const TfIdfIndex& index, const In<uint32_t>& words) {
            return ToNumpy(index.Scores(ToVector(words)));
          },
          "words"_a,
          "Scores (size,) from 0 to 1. Raises ValueError on a word not in the vocabulary.")
      .def_prop_ro("size", &TfIdfIndex::size, "Number of keyframes.")
      .def("__len__", &TfIdfIndex::size);
}

}  // namespace

void BindPlaceRecognition(nb::module_& m) {
  BindVocabulary<BinaryDescriptor>(
      m, "Vocabulary", "Visual words of 256-bit descriptors (ORB), by hierarchical k-majority.");
  BindVocabulary<ByteDescriptor>(
      m, "ByteVocabulary", "Visual words of 128-byte descriptors (SIFT), by hierarchical k-means.");
  BindIndices(m);
}

}  // namespace covinz
